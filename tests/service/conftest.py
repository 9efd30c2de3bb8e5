from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from labdaemon.stream.client import Client
from labdaemon.testing.free_port import free_address

START_S = 120.0


class DaemonProcess:
    """`labdaemon run` as a process."""

    def __init__(self, config: Path, data: Path, *options: str) -> None:
        command = [
            sys.executable,
            "-c",
            "from labdaemon.cli.main import main; main()",
            "run",
            str(config),
            "--data",
            str(data),
            "--json",
            *options,
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        self.addresses: dict[str, str] = {}

    def _read(self) -> None:
        assert self.process.stdout is not None
        self._lines.put(self.process.stdout.readline())

    def ready(self) -> DaemonProcess:
        line = self._lines.get(timeout=START_S)
        assert line, self.process.stderr.read() if self.process.stderr else "it has died"
        self.addresses = json.loads(line)
        return self

    def ask(self, method: str, **params: Any) -> Any:
        with Client(self.addresses["commands"], timeout_s=60.0) as client:
            return client.call(method, **params)

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Exit status, and what it said on stderr; 0 waits for it to end by itself."""
        if number and self.process.poll() is None:
            self.process.send_signal(number)
        self.process.wait(120)
        assert self.process.stderr is not None
        return self.process.returncode, self.process.stderr.read()


@pytest.fixture(scope="module")
def rig() -> Iterator[Any]:
    """A simulated rig in a process of its own, with small frames."""
    [entry] = entry_points(group="labdaemon.simulators", name="rig")
    with entry.load()(seed=3, small=True) as running:
        yield running


@pytest.fixture
def config(rig: Any, tmp_path: Path) -> Path:
    """A rig file that reaches it."""
    folder = tmp_path / "rig"
    folder.mkdir()
    return rig.write_files(folder, events=free_address(), commands=free_address(), data=str(tmp_path / "data"))


@pytest.fixture
def daemons() -> Iterator[list[DaemonProcess]]:
    """Processes to end with the test."""
    started: list[DaemonProcess] = []
    yield started
    for daemon in started:
        if daemon.process.poll() is None:
            daemon.process.kill()
        daemon.process.wait()
        for pipe in (daemon.process.stdout, daemon.process.stderr):
            if pipe is not None:
                pipe.close()


@pytest.fixture
def start_daemon() -> type[DaemonProcess]:
    """Starts one."""
    return DaemonProcess


@pytest.fixture(autouse=True)
def no_systemd(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "JOURNAL_STREAM"):
        monkeypatch.delenv(name, raising=False)
    assert "NOTIFY_SOCKET" not in os.environ


@pytest.fixture
def free_addresses() -> tuple[str, str]:
    """Addresses for events and commands."""
    return free_address(), free_address()
