"""The command of `[service] on_fault`: real processes, a real journal, gaps of milliseconds."""

from __future__ import annotations

import asyncio
import json
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from labdaemon.clock import SystemClock
from labdaemon.errors import ConfigError
from labdaemon.events import FaultData
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal
from labdaemon.rig_sections import ServiceSection
from labdaemon.service.fault_hook import FaultHook, message_of, resolve_command

GAP_S = 0.3
PLACE = {"rig": "/etc/rig.toml", "data": "/data", "host": "lab-pc", "pid": 7}
KEEP = """
import os, sys
folder, text = sys.argv[1], sys.stdin.read()
whole = os.path.join(folder, str(len(os.listdir(folder))))
with open(folder + ".part", "w") as file:
    file.write(text)
os.rename(folder + ".part", whole)
"""


async def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


def serve(
    tmp_path: Path,
    command: list[str],
    scenario: Callable[[FaultHook, Journal], Awaitable[None]],
    timeout_s: float = 60.0,
) -> None:
    async def main() -> None:
        journal = Journal(tmp_path / "data", SystemClock())
        hook = FaultHook(command, journal, PLACE, SystemClock(), gather_s=0.1, gap_s=GAP_S, timeout_s=timeout_s)
        running = asyncio.create_task(hook.run())
        try:
            await scenario(hook, journal)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
            journal.close()

    asyncio.run(main())


def runs(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(path.read_text()) for path in sorted(folder.iterdir(), key=lambda path: int(path.name))]


def test_events_that_come_together_are_one_message_and_none_is_left_out(tmp_path: Path):
    kept = tmp_path / "kept"
    kept.mkdir()
    took_s: list[float] = []

    async def scenario(hook: FaultHook, journal: Journal) -> None:
        id = transitions.submit(journal, "night", "", "")
        transitions.move_campaign(journal, id, "running")
        transitions.fault(journal, id, FaultData(device="shaker", message="port is gone"))
        transitions.move_campaign(journal, id, "paused", "port is gone")
        hook.wake()
        await until(lambda: len(list(kept.iterdir())) == 1)
        began_s = time.monotonic()
        for number in range(20):
            transitions.fault(journal, id, FaultData(message=f"again {number}"))
            hook.wake()
            await asyncio.sleep(0.01)
        hook.fault_unrecorded(None, FaultData(device="disk", message="the disk is full"))
        await until(lambda: sum(len(run["events"]) for run in runs(kept) if run) >= 23)
        took_s.append(time.monotonic() - began_s)

    serve(tmp_path, [sys.executable, "-c", KEEP, str(kept)], scenario)
    first, *later = runs(kept)
    assert (first["kind"], first["data"]["reason"]) == ("campaign.paused", "port is gone")
    assert first["text"] == "lab-pc: 0001-night: paused: port is gone"
    assert [event["kind"] for event in first["events"]] == ["fault", "campaign.paused"]
    assert first["daemon"] == PLACE
    assert 1 <= len(later) <= took_s[0] / GAP_S + 1  # 21 events, with a distance between two runs
    assert "the disk is full" in [event["data"]["message"] for run in later for event in run["events"]]


def test_a_system_without_threads_delays_the_message_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    kept = tmp_path / "kept"
    kept.mkdir()

    async def scenario(hook: FaultHook, journal: Journal) -> None:
        def refuse(thread: threading.Thread) -> None:
            refused.append(thread.name)
            raise RuntimeError("can't start new thread")

        refused: list[str] = []
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", refuse)
            transitions.fault(journal, None, FaultData(message="first"))
            hook.wake()
            await until(lambda: bool(refused))
        transitions.fault(journal, None, FaultData(message="second"))
        hook.wake()
        await until(lambda: sum(len(run["events"]) for run in runs(kept)) == 2)

    serve(tmp_path, [sys.executable, "-c", KEEP, str(kept)], scenario)


@pytest.mark.parametrize(
    "source",
    [
        "import time; time.sleep(60)",
        "import os; os.write(1, b'\\xe9\\xff' * 100000); os._exit(3)",
        "import os; os.abort()",
    ],
)
def test_a_command_that_hangs_fails_or_babbles_holds_nothing_up(tmp_path: Path, source: str):
    async def scenario(hook: FaultHook, journal: Journal) -> None:
        for _ in range(3):
            transitions.fault(journal, None, FaultData(message="x" * 5000))
            hook.wake()
            before = time.monotonic()
            await asyncio.sleep(0.2)
            assert time.monotonic() - before < 20.0  # the loop stayed free

    serve(tmp_path, [sys.executable, "-c", source], scenario, timeout_s=30.0)


def test_no_shell_sees_the_command_or_the_message(tmp_path: Path):
    section = ServiceSection(on_fault="mail -s '$(touch x); done' root")
    assert section.on_fault_command == ("mail", "-s", "$(touch x); done", "root")
    assert ServiceSection(on_fault=("a b", "c")).on_fault_command == ("a b", "c")
    assert ServiceSection().on_fault_command is None
    for wrong in ("", "   ", "mail 'x", "a\0b", ()):
        with pytest.raises(ValueError, match="on_fault"):
            ServiceSection(on_fault=wrong)


def test_the_program_must_be_there_and_lies_next_to_the_rig_file(tmp_path: Path):
    script = tmp_path / "page.sh"
    script.write_text("#!/bin/sh\n")
    rig = tmp_path / "rig.toml"
    with pytest.raises(ConfigError, match=r"service\.on_fault: \./page\.sh is no program"):
        resolve_command(("./page.sh",), rig)
    script.chmod(0o755)
    assert resolve_command(("./page.sh", "-x"), rig) == (str(script), "-x")
    assert resolve_command(("sh",), rig)[0].endswith("/sh")


def test_the_message_leads_with_what_weighs_most():
    fault = {"kind": "fault", "campaign": None, "data": {"device": "left", "message": "left: gone"}}
    assert message_of([fault], PLACE)["text"] == "lab-pc: left: fault: left: gone"
    failed = {"kind": "campaign.failed", "campaign": "1-x", "data": {"reason": "r"}}
    assert message_of([failed, fault], PLACE)["kind"] == "campaign.failed"
