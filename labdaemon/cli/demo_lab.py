"""A laboratory for `demo`: the simulated rig and the daemon, each a process of its own, ended in the right order."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import IO, Any, Protocol

from labdaemon.durable import write_durably
from labdaemon.errors import LabdaemonError, UsageError
from labdaemon.stream.client import Client, EventStream

READY_S = 120.0
"""Longest that the daemon may take to serve."""
SILENT_S = 60.0
"""A daemon that is not heard for so long hangs; a busy machine alone delays heartbeats by seconds."""
FREE = "tcp://127.0.0.1:*"
END_S = 20.0
"""Longest that the daemon may take to bring the table to rest and end."""


class DemoRig(Protocol):
    """What the entry point ``rig`` of ``labdaemon.simulators`` starts."""

    def write_files(self, folder: Path, *, events: str, commands: str, data: str) -> Path:
        """Write the rig file that reaches it; returns its path."""
        ...

    def truth(self) -> list[dict[str, Any]]:
        """Every exposure made: ``camera``, ``opened_at``, ``exposure_s`` and ``targets`` by name."""
        ...

    def modes(self) -> list[dict[str, float]]:
        """``frequency_hz`` and ``damping`` of the structure's modes, ascending."""
        ...

    def table(self) -> dict[str, Any]:
        """``moving`` and more."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class DemoFailed(LabdaemonError):
    """The demo's own laboratory failed."""


class DemoLab:
    """A simulated rig and a daemon on it.

    Attributes
    ----------
    rig
        The simulator's handle.
    client
        Connected to the daemon.
    """

    def __init__(self, rig: DemoRig, daemon: subprocess.Popen[str], client: Client) -> None:
        self.rig: DemoRig = rig
        self.client: Client = client
        self._daemon = daemon

    def events(self) -> Iterator[dict[str, Any]]:
        """The journal's events from its beginning, for as long as the daemon lives.

        Raises
        ------
        DemoFailed
            The daemon has ended, or has been silent for too long.
        """
        stream = EventStream(self.client, after=0)
        heard = time.monotonic()
        try:
            while True:
                event = stream.receive(1.0)
                status = self._daemon.poll()
                if event is not None:
                    heard = time.monotonic()
                    yield event
                elif status is not None:
                    raise DemoFailed(f"the daemon ended with exit status {status}")
                elif time.monotonic() > heard + SILENT_S:
                    raise DemoFailed(f"the daemon has been silent for {SILENT_S:g} s")
        finally:
            stream.close()


@contextlib.contextmanager
def laboratory(
    out: Path, *, commands: str = FREE, events: str = FREE, more: str = "", modification: str = "none"
) -> Iterator[DemoLab]:
    """Start rig and daemon; at the end, however it comes, the table is at rest and both processes are gone.

    Parameters
    ----------
    out
        Folder for the rig file, the daemon's folder ``daemon`` and the log ``daemon.log``.
    commands, events
        Where the daemon listens; free ports by default.
    more
        Further sections of the rig file.
    modification
        What is done to the simulated structure; ``none`` is the frame as it is.

    Raises
    ------
    DemoFailed
        One of them did not start, or the table was not at rest at the end.
    UsageError
        The simulators are not installed.
    """
    with contextlib.ExitStack() as stack:
        rig = _start_rig(modification)
        stack.callback(rig.close)
        config = rig.write_files(out, events=events, commands=commands, data="daemon")
        if more:
            write_durably(config, config.read_text(encoding="utf-8") + more)
        log = stack.enter_context((out / "daemon.log").open("w", encoding="utf-8"))
        daemon = _start_daemon(config, log)
        stack.callback(_leave_at_rest, rig, daemon, config, log)
        addresses = _addresses(daemon)
        client = stack.enter_context(Client(addresses["commands"], addresses["events"], timeout_s=30.0))
        yield DemoLab(rig, daemon, client)
        _end(daemon)
        if rig.table()["moving"]:
            raise DemoFailed("the daemon ended and left the table moving")


def simulator(name: str) -> Any:
    """What the entry point group ``labdaemon.simulators`` has under a name.

    Raises
    ------
    UsageError
        The simulators are not installed.
    """
    found = entry_points(group="labdaemon.simulators")
    if name not in found.names:
        raise UsageError(f"the simulators are not installed (no entry point labdaemon.simulators:{name})")
    return found[name].load()


def _start_rig(modification: str) -> DemoRig:
    try:
        rig: DemoRig = simulator("rig")(modification=modification)
    except (RuntimeError, ValueError, OSError) as exc:
        raise DemoFailed(f"the simulated rig did not start: {exc}") from exc
    return rig


def _start_daemon(config: Path, log: IO[str]) -> subprocess.Popen[str]:
    """In a session of its own, so that Ctrl-C reaches only us and we end things in order."""
    command = [sys.executable, "-P", "-m", "labdaemon", "run", str(config), "--json"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True, env=environment
    )


def _addresses(daemon: subprocess.Popen[str]) -> dict[str, str]:
    """What the daemon prints once it serves."""
    assert daemon.stdout is not None
    deadline = time.monotonic() + READY_S
    readable: list[Any] = []
    while not readable and time.monotonic() < deadline:
        readable, _, _ = select.select([daemon.stdout], [], [], 0.5)
    line = daemon.stdout.readline() if readable else ""
    try:
        addresses: dict[str, str] = json.loads(line)
    except json.JSONDecodeError:
        status = daemon.poll()
        reason = "did not serve in time" if status is None else f"ended with exit status {status}"
        raise DemoFailed(f"the daemon {reason}") from None
    return addresses


def _leave_at_rest(rig: DemoRig, daemon: subprocess.Popen[str], config: Path, log: IO[str]) -> None:
    """End the daemon; if it left the table moving (it was killed), do what systemd would do after it."""
    _end(daemon)
    with contextlib.suppress(OSError, EOFError, ValueError):  # the rig has ended too: nothing moves any more
        if rig.table()["moving"]:
            command = [sys.executable, "-P", "-m", "labdaemon", "safe-stop", str(config)]
            subprocess.run(command, stdout=log, stderr=log, timeout=END_S, check=False)


def _end(daemon: subprocess.Popen[str]) -> None:
    """Ask the daemon to end, which brings the table to rest, and insist if it does not."""
    if daemon.poll() is None:
        daemon.send_signal(signal.SIGTERM)
        try:
            daemon.wait(END_S)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait()
    if daemon.stdout is not None:
        daemon.stdout.close()
