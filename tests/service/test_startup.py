"""What is missing at the start is waited for, with the table at rest and commands answered."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.devices import CameraInfo
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.capture.table import Table
from labdaemon.clock import SystemClock
from labdaemon.errors import DeviceError, StorageError, TransportError
from labdaemon.journal.journal import Journal
from labdaemon.journal.storage import JournalError
from labdaemon.service import deferred_commands as deferred_module
from labdaemon.service import startup as start_module
from labdaemon.service.deferred_commands import DeferredCommands
from labdaemon.service.startup import DATA, EndRequest, StartupSequence
from labdaemon.stream.messages import DEVICE, WRONG_STATE, WrongStateError, code_of


class LateDevice:
    """A gauge or camera that answers from some time on."""

    role, unit = "response", "mm"

    def __init__(self, name: str) -> None:
        self.name, self.is_there, self.closed = name, False, 0

    def connect(self) -> Any:
        if not self.is_there:
            raise TransportError("its port does not open", device=self.name)
        return CameraInfo("maker", "body", self.name) if self.name == "left" else "a gauge"

    def exposure_steps_s(self) -> tuple[float, ...]:
        return (0.5, 1.0)

    def close(self) -> None:
        self.closed += 1


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(start_module, "RETRY_S", 0.01)
    monkeypatch.setattr(deferred_module, "PATIENCE_S", 0.05)


@pytest.fixture
async def start() -> StartupSequence:
    clock = SystemClock()
    end: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    return StartupSequence(clock, Table(Rig(None, None, {}), clock, None), {"pid": 1}, end)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(120.0):
        while not condition():
            await asyncio.sleep(0.005)


async def test_devices_that_come_late_are_named_and_taken_up(start: StartupSequence):
    left, gauge = LateDevice("left"), LateDevice("gauge")
    rig = Rig(
        None,
        None,
        {"left": DeviceHandle(left, ThreadExecutor("left"))},
        (DeviceHandle(gauge, ThreadExecutor("gauge")),),
    )  # type: ignore[arg-type]
    waiting = asyncio.create_task(start.reach_devices(rig, {"shaker": "known"}))
    await until(lambda: set(start.waiting_for) == {"left", "gauge"})
    status = await start.handlers()["status"]({})
    assert (status["state"], status["table"], status["campaign"]) == ("starting", None, None)
    assert "its port does not open" in status["waiting_for"]["left"]
    refusal = start.refusal()
    assert isinstance(refusal, DeviceError)
    assert (refusal.device in {"left", "gauge"}, code_of(refusal)) == (True, DEVICE)
    gauge.is_there = True
    await until(lambda: set(start.waiting_for) == {"left"})
    assert not waiting.done()
    left.is_there = True
    found, steps = await waiting
    assert found == {"shaker": "known", "left": "maker body left", "gauge": "a gauge"}
    assert steps == {"left": (0.5, 1.0)}
    assert start.status()["waiting_for"] == {}
    assert left.closed > 0


async def test_the_end_is_not_waited_for(start: StartupSequence):
    rig = Rig(None, None, {"left": DeviceHandle(LateDevice("left"), ThreadExecutor("left"))})  # type: ignore[arg-type]
    waiting = asyncio.create_task(start.reach_devices(rig, {}))
    await until(lambda: "left" in start.waiting_for)
    start.end.set_result(0)
    with pytest.raises(EndRequest):
        await waiting


async def test_an_error_of_a_running_part_ends_the_wait(start: StartupSequence):
    async def fail() -> None:
        raise OSError("broken")

    start.parts.append(asyncio.create_task(fail()))
    rig = Rig(None, None, {"left": DeviceHandle(LateDevice("left"), ThreadExecutor("left"))})  # type: ignore[arg-type]
    with pytest.raises(OSError, match="broken"):
        await start.reach_devices(rig, {})


@pytest.mark.parametrize("obstacle", ["file", "link"])
async def test_a_data_folder_that_comes_late_is_waited_for(start: StartupSequence, tmp_path: Path, obstacle: str):
    disk = tmp_path / "disk"
    if obstacle == "file":
        disk.write_text("nothing is mounted here yet")
    else:
        disk.symlink_to(tmp_path / "not there yet")
    waiting = asyncio.create_task(start.open_journal(disk / "data", False))
    await until(lambda: DATA in start.waiting_for)
    assert start.status()["doing"] == f"waiting for {DATA}"
    assert isinstance(start.refusal(), WrongStateError)
    assert code_of(start.refusal()) == WRONG_STATE
    disk.unlink()
    disk.mkdir()
    (await waiting).close()
    assert start.status()["doing"] == "starting"


async def test_a_journal_that_another_process_has_locked_is_waited_for(
    start: StartupSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("labdaemon.journal.journal.BUSY_S", 0.05)
    Journal(tmp_path, SystemClock()).close()
    other = sqlite3.connect(tmp_path / "journal.db", isolation_level=None)
    other.execute("PRAGMA locking_mode = EXCLUSIVE")
    other.execute("BEGIN EXCLUSIVE")
    waiting = asyncio.create_task(start.open_journal(tmp_path, False))
    await until(lambda: "locked" in start.waiting_for.get(DATA, ""))
    other.close()
    (await waiting).close()


@pytest.mark.parametrize("what", ["damaged", "name", "held"])
async def test_what_a_person_must_change_is_not_waited_for(start: StartupSequence, tmp_path: Path, what: str):
    folder, held = tmp_path, None
    if what == "damaged":
        (tmp_path / "journal.db").write_bytes(b"\xa5" * 8192)
    elif what == "name":
        folder = tmp_path / ("x" * 300)
    else:
        held = Journal(tmp_path, SystemClock())
    with pytest.raises(StorageError) as raised:
        await start.open_journal(folder, False)
    assert raised.value.exit_status == 2
    assert isinstance(raised.value, JournalError) == (what != "name")
    if held is not None:
        held.close()


async def test_commands_that_need_what_is_missing_are_refused_by_its_name(start: StartupSequence):
    deferred = DeferredCommands()
    deferred.serve_early(start.handlers(), start.refusal)
    start.waiting_for["left"] = "left: its port does not open"
    handlers = deferred.handlers()
    assert (await handlers["status"]({}))["state"] == "starting"
    assert (await handlers["stop"]({}))["rest"] == "none"
    with pytest.raises(
        DeviceError, match=r"^left: the daemon waits for it and serves when it is there \(its port does not open\)$"
    ):
        await handlers["campaign.submit"]({"toml": ""})
