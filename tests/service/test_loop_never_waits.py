"""The event loop waits for no disk: while the daemon serves, its thread opens, syncs, lists and removes no file."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

CAMPAIGN = """
name = "watched"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
at_rest = false
[[phase]]
kind = "steps"
frequency_hz = [6.0, 7.0]
amplitude_mm = 0.5
exposure_s = 0.25
captures = 2
settle = { max_change_per_cycle = 0.5, timeout_s = 1 }
"""

WATCH = '''
"""Writes down every call of the event loop's thread that can wait for a disk."""
import os, sys, threading, traceback
WATCHED = {"open", "os.listdir", "os.scandir", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.truncate",
           "fcntl.flock", "sqlite3.connect", "subprocess.Popen"}
out = os.open(OUT, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
busy = threading.local()

def note(event, about):
    running = getattr(sys.modules.get("_asyncio"), "_get_running_loop", None)
    if running is None or getattr(busy, "on", False) or threading.current_thread() is not threading.main_thread():
        return
    if running() is None or str(about).startswith((sys.prefix, sys.base_prefix, SOURCE, "/proc/")):
        return  # a module that is imported late is no data, and what the kernel reports lies on no disk
    busy.on = True
    text = "".join(traceback.format_list(traceback.extract_stack(limit=8)[:-2]))
    os.write(out, f"{event} {about!r}\\n{text}\\n".encode())
    busy.on = False

sys.addaudithook(lambda event, args: note(event, args[0] if args else "") if event in WATCHED else None)
for name in ("fsync", "fdatasync", "statvfs"):
    def watched(*args, real=getattr(os, name), name=name):
        note(f"os.{name}", args[0])
        return real(*args)
    setattr(os, name, watched)
'''


@pytest.fixture
def notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the next daemon's event loop did that can wait for a disk."""
    folder, out = tmp_path / "site", tmp_path / "notes"
    folder.mkdir()
    source = str(Path(__file__).parents[2])
    (folder / "sitecustomize.py").write_text(f"OUT, SOURCE = {str(out)!r}, {source!r}\n{WATCH}")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return out


def wait_for(daemon: Any, condition: Callable[[dict[str, Any]], bool]) -> None:
    deadline = time.monotonic() + 120
    while not condition(daemon.ask("status")):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_no_file_is_touched_on_the_event_loop_while_the_daemon_serves(
    config: Path, tmp_path: Path, daemons: list[Any], start_daemon: Any, notes: Path
):
    for attempt in range(2):  # the second one takes the first one's campaign up
        daemon = start_daemon(config, tmp_path / "data")
        daemons.append(daemon)
        daemon.ready()
        wait_for(daemon, lambda status: status["state"] != "starting")  # on a busy machine a device may come late
        assert "control.csv" in notes.read_text()  # it watches: some files are read at the start
        served = notes.stat().st_size
        if not attempt:
            daemon.ask("campaign.submit", toml=CAMPAIGN)
            wait_for(daemon, lambda status: status["step"] is not None)
            daemon.ask("campaign.pause")
            daemon.ask("capture", label="by hand")
            daemon.ask("campaign.resume")
        else:
            wait_for(daemon, lambda status: status["state"] == "paused")  # by the stop
            daemon.ask("campaign.resume")
            wait_for(daemon, lambda status: status["state"] == "idle")
        daemon.ask("events.replay", after=0)
        daemon.ask("stop")
        assert notes.read_text()[served:] == ""
        daemon.process.kill()
        daemon.process.wait()
        notes.write_text("")
