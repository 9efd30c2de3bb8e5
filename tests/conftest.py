"""Fixtures that all tests share."""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

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
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("no chromium is installed")
    opened: list[Browser] = []

    def start(address: str, size: tuple[int, int] = (1200, 900)) -> Browser:
        opened.append(Browser(program, address, tmp_path / f"profile-{len(opened)}", size))
        return opened[-1]

    yield start
    for one in opened:
        one.close()


class Browser:
    """A page in a headless Chromium, driven through two pipes by the DevTools protocol; no package is needed for it.

    Parameters
    ----------
    program
        The browser.
    address
        What to open.
    profile
        Folder for its files.
    size
        Width and height of the window, CSS pixels.
    """

    def __init__(self, program: str, address: str, profile: Path, size: tuple[int, int]) -> None:
        to_read, self._send = os.pipe()
        self._receive, to_write = os.pipe()
        options = [
            *("--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", "--no-first-run"),
            *(f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"),
        ]
        # The browser talks on descriptors 3 and 4; copies first, as the pipes may have these numbers.
        start = (
            "import fcntl, os, sys; read, write = (fcntl.fcntl(int(one), fcntl.F_DUPFD, 10) for one in sys.argv[1:3]); "
            "os.dup2(read, 3); os.dup2(write, 4); os.execv(sys.argv[3], sys.argv[3:])"
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", start, str(to_read), str(to_write), program, *options],
            pass_fds=(to_read, to_write),
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self._buffer, self._number = b"", 0
        self._session: str | None = None
        target = self.call("Target.createTarget", url=address)["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A command and its answer; events in between are left out."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(str(answer["error"]))
                result: dict[str, Any] = answer["result"]
                return result

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression in the page."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"]))
        return found["result"].get("value")

    def wait_for(self, expression: str, limit_s: float = 60.0) -> Any:
        """The value of an expression as soon as it is true."""
        end = time.monotonic() + limit_s
        while True:
            try:
                if value := self.evaluate(expression):
                    return value
            except RuntimeError:
                if time.monotonic() > end:  # until then the page is being loaded
                    raise
            if time.monotonic() > end:
                raise TimeoutError(f"{expression} in {self.evaluate('document.body.innerText')!r}")
            time.sleep(0.05)

    def screenshot(self, path: Path) -> None:
        """Write what is shown as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._send)
        os.close(self._receive)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            data = os.read(self._receive, 1 << 16)
            if not data:
                raise RuntimeError("the browser has ended")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\0")
        message: dict[str, Any] = json.loads(line)
        return message
