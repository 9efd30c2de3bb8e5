"""Whoever watches shaker and trigger in every state, on a rig in memory."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

import pytest

from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.capture.table_monitor import TableMonitor
from labdaemon.clock import SimulatedClock
from labdaemon.errors import LabdaemonError, RestUnconfirmed
from labdaemon.testing.rig import FakeRig, fake_rig

GONE = ["gone"] * 200


@dataclass
class Scene:
    """A table that is kept."""

    fake: FakeRig
    table: Table
    table_monitor: TableMonitor
    clock: SimulatedClock
    faults: list[tuple[float, str]] = field(default_factory=list)
    trips: list[LabdaemonError] = field(default_factory=list)

    def report(self, error: LabdaemonError, action: str) -> None:
        self.faults.append((self.clock.monotonic(), str(error)))

    def trip(self, error: LabdaemonError) -> None:
        self.trips.append(error)

    def lose(self, *devices: str) -> None:
        for device in devices:
            for operation in ("state", "stop", "stop_now", "connect", "heartbeat", "drop_enable", "read"):
                self.fake.world.fail(f"{device}.{operation}", *GONE)  # type: ignore[arg-type]

    def find(self) -> None:
        self.fake.world.faults.clear()


def run(scenario: Callable[[Scene], Awaitable[None]]) -> None:
    clock = SimulatedClock()
    fake = fake_rig(clock)
    table = Table(fake.rig, clock, 0.2)
    scene = Scene(fake, table, TableMonitor(fake.rig, table, clock), clock)
    scene.table_monitor.observer = scene

    async def main() -> None:
        await table.stop(at_once=True)
        keeping = asyncio.create_task(scene.table_monitor.run())
        await clock.sleep(3.0)
        assert table.state == "rest"
        await scenario(scene)
        keeping.cancel()

    clock.run(main())


@pytest.mark.parametrize("device", ["shaker", "trigger"])
def test_a_wire_that_is_lost_while_idle_is_a_fault_within_three_seconds_and_comes_back(device: str):
    async def scenario(scene: Scene) -> None:
        lost_s = scene.clock.monotonic()
        scene.lose(device)
        await scene.clock.sleep(3.0)
        [(at_s, message)] = scene.faults
        assert at_s - lost_s <= 3.0
        assert message.startswith(f"{device}: port is gone")
        assert "use the emergency stop" in message
        await scene.clock.sleep(20.0)
        assert len(scene.faults) == 1
        assert scene.table.state == ("unconfirmed" if device == "shaker" else "rest")
        scene.find()
        await scene.clock.sleep(4.0)
        assert scene.table.state == "rest"
        assert not scene.table_monitor.lost
        assert scene.trips == []

    run(scenario)


def test_a_shaker_that_is_lost_while_the_table_moves_stops_it():
    async def scenario(scene: Scene) -> None:
        await scene.table.excite(Excitation(5.0, 1.0))
        scene.lose("shaker")
        await scene.clock.sleep(3.0)
        [trip] = scene.trips
        assert "port is gone" in str(trip)

    run(scenario)


def test_a_stop_that_nothing_confirmed_is_tried_again_each_second():
    async def scenario(scene: Scene) -> None:
        await scene.table.excite(Excitation(5.0, 1.0))
        scene.lose("shaker", "trigger", "table")
        with pytest.raises(RestUnconfirmed):
            await scene.table.stop()
        tried = len(scene.fake.world.faults["shaker.stop_now"])
        await scene.clock.sleep(10.0)
        assert tried - len(scene.fake.world.faults["shaker.stop_now"]) >= 5
        scene.find()
        await scene.clock.sleep(4.0)
        assert not scene.fake.world.running
        assert scene.table.state == "rest"
        assert scene.table.unconfirmed is None

    run(scenario)


def test_a_line_that_nothing_of_ours_raised_is_dropped():
    async def scenario(scene: Scene) -> None:
        scene.fake.trigger.raise_enable()  # an earlier process did
        await scene.clock.sleep(5.0)
        assert not scene.fake.world.enabled

    run(scenario)


def test_a_table_that_a_person_moves_is_reported_once_and_left_alone():
    async def scenario(scene: Scene) -> None:
        scene.fake.world.drive(True, 5.0, 1.0)
        await scene.clock.sleep(10.0)
        [(_, message)] = scene.faults
        assert "moves although nothing of ours moves it" in message
        assert scene.table.state == "moving"
        assert scene.fake.world.running

    run(scenario)
