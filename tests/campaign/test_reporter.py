"""Faults and states of campaigns on their way into the journal, however long the disk takes nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.reporter import DISK_POLL_S, RECORD_S, CampaignReporter
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, InterlockError, StorageFull
from labdaemon.events import FaultData
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal


class Lab:
    """A reporter on a journal whose disk a test fills; it notes what was reported by another way."""

    def __init__(self, folder: Path) -> None:
        self.clock = SimulatedClock()
        self.journal = Journal(folder, self.clock, synchronous="OFF")
        self.free_bytes = 10**12
        self.recorder = FullDiskRecorder(self)
        self.reporter = CampaignReporter(
            self.recorder, self.clock, DataDisk(self.recorder, lambda: self.free_bytes, 10**9)
        )
        self.reporter.observer = self
        self.unrecorded: list[tuple[str | None, str | None]] = []

    def fault_unrecorded(self, campaign: str | None, data: FaultData) -> None:
        self.unrecorded.append((campaign, data.action))

    def faults(self) -> list[dict[str, Any]]:
        return [event.data for event in self.journal.events_after(0, 100) if event.kind == "fault"]


class FullDiskRecorder(Recorder):
    """Refuses writes while its lab's disk is full."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab.journal, InlineExecutor("journal", lambda: 0.0))
        self._lab = lab

    async def write(self, transition: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        if self._lab.free_bytes < 10**9:
            raise StorageFull("the disk is full")
        return await super().write(transition, *args, **kwargs)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    """Run a scenario with a lab, in simulated time."""
    lab = Lab(tmp_path)

    def start(scenario: Callable[[Lab], Coroutine[Any, Any, None]]) -> Lab:
        lab.clock.run(scenario(lab))
        return lab

    yield start
    lab.journal.close()


def test_a_fault_names_its_device_and_what_is_done(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.reporter.fault(DeviceError("no answer", device="left"), campaign=None, step=None, action="retry")
        await lab.reporter.fault(InterlockError("too large"), campaign=None, step=None, action="pause")

    lab = run(scenario)
    assert lab.faults() == [
        {"device": "left", "error": "DeviceError", "message": "left: no answer", "step": None, "action": "retry"},
        {"device": None, "error": "InterlockError", "message": "too large", "step": None, "action": "pause"},
    ]
    assert (lab.reporter.faults, lab.reporter.last_fault) == (2, "too large")


def test_a_fault_that_the_disk_does_not_take_goes_another_way(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.free_bytes = 0
        await lab.reporter.fault(DeviceError("no answer"), campaign="c", step=None, action="retry")

    lab = run(scenario)
    assert lab.unrecorded == [("c", "retry")]
    assert lab.faults() == []
    assert lab.reporter.faults == 1


def test_work_is_done_again_once_the_disk_takes_writes(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        id = transitions.submit(lab.journal, "night", "", "")
        lab.free_bytes = 0
        asyncio.get_running_loop().call_later(100.0, setattr, lab, "free_bytes", 10**12)
        assert await lab.reporter.move(id, "running")
        assert lab.clock.monotonic() == pytest.approx(100.0, abs=DISK_POLL_S + 0.1)
        assert lab.reporter.disk_trouble is None

    lab = run(scenario)
    [fault] = lab.faults()
    assert fault["action"] == "waited"
    assert "took nothing for 10" in fault["message"]
    assert lab.unrecorded == [(None, "wait")]


def test_several_that_wait_for_the_disk_are_one_fault(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        ids = [transitions.submit(lab.journal, name, "", "") for name in ("a", "b", "c")]
        lab.free_bytes = 0
        asyncio.get_running_loop().call_later(30.0, setattr, lab, "free_bytes", 10**12)
        moves = [asyncio.create_task(lab.reporter.move(id, "running")) for id in ids]
        await asyncio.sleep(10.0)
        assert lab.reporter.disk_trouble is not None
        assert await asyncio.gather(*moves) == [True, True, True]

    lab = run(scenario)
    assert len(lab.faults()) == 1
    assert lab.reporter.faults == 1


def test_a_stop_waits_no_longer_than_a_moment_for_its_record(run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario(lab: Lab) -> None:
        async def never(*_: Any, **__: Any) -> None:
            await asyncio.sleep(1e5)

        monkeypatch.setattr(lab.recorder, "write", never)
        await lab.reporter.fault_soon(DeviceError("brought to rest by the enable line"), action="look at the shaker")
        assert lab.clock.monotonic() == pytest.approx(RECORD_S)

    run(scenario)
