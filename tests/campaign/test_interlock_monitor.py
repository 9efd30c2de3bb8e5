"""The loops that watch the rig while the table moves, and what trips."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.interlock_monitor import MISSES, InterlockMonitor
from labdaemon.campaign.interlocks import InterlockLimits
from labdaemon.campaign.run_control import RunControl
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, InterlockError, LabdaemonError, StorageUnavailable
from labdaemon.journal.journal import Journal
from labdaemon.testing.rig import fake_rig

LIMITS = InterlockLimits(max_response_mm=20.0, worker_stall_s=60.0)


class Watch:
    """A monitor of the fake rig whose table moves; it notes what trips instead of stopping."""

    def __init__(self, folder: Path) -> None:
        self.clock = SimulatedClock()
        self.fake = fake_rig(self.clock)
        self.journal = Journal(folder, self.clock, synchronous="OFF")
        recorder = Recorder(self.journal, InlineExecutor("journal", lambda: 0.0))
        self.table = Table(self.fake.rig, self.clock, None)
        context = AcquisitionContext(self.fake.rig, self.table, recorder, self.clock, folder)
        self.free_bytes, self.oldest = 10**12, 0.0
        self.control = RunControl()
        disk = DataDisk(recorder, lambda: self.free_bytes, 10**9)
        self.monitor = InterlockMonitor(context, LIMITS, self, disk, self, self.control)
        self.trips: list[LabdaemonError] = []

    def trip(self, error: LabdaemonError) -> None:
        self.trips.append(error)

    def oldest_s(self) -> float:
        return self.oldest

    def move(self, amplitude_mm: float = 2.0) -> None:
        """As the step runner leaves it: enabled, set, settled."""
        self.fake.trigger.raise_enable()
        self.fake.shaker.set(5.0, amplitude_mm)
        self.table.enabled = True
        self.table.excitation = Excitation(5.0, amplitude_mm)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    def start(scenario: Callable[[Watch], Coroutine[Any, Any, None]]) -> Watch:
        watch = Watch(tmp_path)

        async def main() -> None:
            task = asyncio.create_task(watch.monitor.run())
            try:
                await scenario(watch)
                assert not task.done(), task.exception()
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
                watch.journal.close()

        watch.clock.run(main())
        return watch

    return start


def test_a_rig_that_is_well_trips_nothing(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        await asyncio.sleep(120.0)

    watch = run(scenario)
    assert watch.trips == []
    assert watch.monitor.iterations > 100
    assert watch.fake.world.is_enabled(), "the heartbeat holds the line"


def test_too_large_a_response_trips(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move(10.0)
        await asyncio.sleep(60.0)

    error = run(scenario).trips[0]
    assert isinstance(error, InterlockError)
    assert "max_response_mm = 20" in str(error)


def test_a_line_that_fell_trips_at_once_and_one_whose_wire_was_lost_may_be_tried_again(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        await asyncio.sleep(5.0)
        watch.fake.world.fail("trigger.heartbeat", "refused")
        await asyncio.sleep(1.0)
        [error] = watch.trips
        assert isinstance(error, InterlockError)
        assert not watch.table.enabled
        watch.trips.clear()
        watch.move()
        watch.fake.world.fail("trigger.heartbeat", "gone", "refused")
        await asyncio.sleep(2.0)
        [error] = watch.trips
        assert isinstance(error, DeviceError)
        assert "fell while its wire was lost" in str(error)

    run(scenario)


@pytest.mark.parametrize("operation", ["trigger.heartbeat", "response.read", "left.status"])
def test_a_device_is_lost_after_several_answers_in_a_row(run: Any, operation: str) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        await asyncio.sleep(5.0)
        watch.fake.world.fail(operation, *["rubbish"] * (MISSES - 1))
        await asyncio.sleep(100.0)
        assert watch.trips == [], "one answer may be lost on any wire"
        watch.fake.world.fail(operation, *["rubbish"] * MISSES)
        await asyncio.sleep(100.0)
        assert isinstance(watch.trips[0], DeviceError)
        assert watch.trips[0].device == operation.partition(".")[0]

    run(scenario)


def test_a_full_disk_trips_only_while_the_table_moves(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.free_bytes = 0
        await asyncio.sleep(30.0)
        assert watch.trips == []
        watch.move()
        await asyncio.sleep(10.0)
        assert isinstance(watch.trips[0], StorageUnavailable)

    run(scenario)


def test_workers_that_stall_trip(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        watch.oldest = 61.0
        await asyncio.sleep(10.0)
        assert isinstance(watch.trips[0], InterlockError)

    run(scenario)


def test_cameras_are_asked_nothing_while_a_capture_is_in_flight(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        asked: list[str] = []
        watch.fake.world.on_call = asked.append
        watch.control.capture_started()
        await asyncio.sleep(100.0)
        assert "left.status" not in asked
        watch.control.capture_ended()
        await asyncio.sleep(40.0)
        assert "left.status" in asked

    run(scenario)


def test_an_empty_battery_trips(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.move()
        watch.fake.cameras[0].battery_percent = 5
        await asyncio.sleep(40.0)
        assert "battery at 5 %" in str(watch.trips[0])

    run(scenario)


def test_nothing_trips_a_table_at_rest(run: Any) -> None:
    async def scenario(watch: Watch) -> None:
        watch.oldest = 1e4
        watch.fake.world.fail("left.status", *["gone"] * 10)
        watch.fake.cameras[1].battery_percent = 1
        await asyncio.sleep(300.0)

    assert run(scenario).trips == []
