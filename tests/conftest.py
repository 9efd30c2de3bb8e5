"""Fixtures that all tests share."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from labdaemon.testing.browser import Browser, browser_program

# Hypothesis gives each example 200 ms, which a busy machine misses; and examples by seed are the same in each run.
settings.register_profile(
    "labdaemon", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("labdaemon")


def pytest_configure() -> None:
    """Let the processes that tests start see signals, also where the suite runs under nohup or in the background."""
    for number, handler in ((signal.SIGHUP, signal.SIG_DFL), (signal.SIGQUIT, signal.SIG_DFL)):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, handler)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real pictures and published adjustments; kept outside the repository."""
    root = Path(os.environ.get("LABDAEMON_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    data = root / "data"
    if not data.is_dir():
        pytest.skip("the shared data folder is absent (set LABDAEMON_SHARED)")
    return data


@pytest.fixture
def socket_folder() -> Iterator[Path]:
    """A folder whose name leaves room for a socket's; that of `tmp_path` may be longer."""
    with tempfile.TemporaryDirectory(prefix="sock-", dir="/tmp") as name:
        yield Path(name)


@pytest.fixture
def open_browser(tmp_path: Path) -> Iterator[Callable[..., Browser]]:
    """Opens an address in a headless Chromium; skips where none is installed."""
    program = browser_program()
    if program is None:
        pytest.skip("no chromium is installed")
    opened: list[Browser] = []

    def start(address: str, size: tuple[int, int] = (1200, 900)) -> Browser:
        opened.append(Browser(program, address, tmp_path / f"profile-{len(opened)}", size))
        return opened[-1]

    yield start
    for one in opened:
        one.close()
