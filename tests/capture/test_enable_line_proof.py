"""The proof that the enable line stops the table, on a rig in memory."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest

from labdaemon.capture.enable_line_proof import LineUnproven, can_prove_enable_line, prove_enable_line
from labdaemon.capture.table import Table
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError
from labdaemon.testing.rig import FakeRig, fake_rig

Scenario = Callable[[FakeRig, Table, SimulatedClock], Awaitable[None]]


def run(scenario: Scenario) -> None:
    clock = SimulatedClock()
    fake = fake_rig(clock)
    table = Table(fake.rig, clock, 0.2)

    async def beat() -> None:  # what the guard does
        while True:
            if table.enabled and fake.world.is_enabled():
                fake.trigger.heartbeat()
            await clock.sleep(0.4)

    async def main() -> None:
        beating = asyncio.create_task(beat())
        await scenario(fake, table, clock)
        beating.cancel()

    clock.run(main())


def test_a_line_that_stops_the_table_is_proven_and_the_table_rests():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)
        assert table.observer.proof == "proven"
        assert table.state == "rest"
        assert fake.world.amplitude_mm == 0.2
        assert not fake.world.running

    run(scenario)


def test_a_line_that_is_wired_to_nothing_fails_and_the_table_rests():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        fake.world.line_wired = False
        with pytest.raises(LineUnproven, match="was seen to move on"):
            await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)
        assert table.observer.proof == "failed"
        assert table.state == "rest"
        assert not fake.world.running

    run(scenario)


def test_a_gauge_that_sees_nothing_proves_nothing():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        fake.gauges[0].gain = 0.0
        with pytest.raises(LineUnproven, match="neither table gauge nor controller saw the table move"):
            await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)
        assert table.observer.proof == "failed"

    run(scenario)


def test_a_gauge_that_is_read_too_late_at_first_is_asked_again():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        fake.world.fail("table.read", *["rubbish"] * 4)
        await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)
        assert table.observer.proof == "proven"

    run(scenario)


def test_a_gauge_that_cannot_be_read_is_named():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        fake.world.fail("table.read", *["rubbish"] * 20)
        with pytest.raises(LineUnproven, match=r"saw the table move \(the gauge could not be read: .*table"):
            await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)

    run(scenario)


def test_a_device_that_fails_meanwhile_leaves_it_untried():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        fake.world.fail("trigger.drop_enable", "gone", "gone")  # the first drop, and the one of a second try
        fake.world.fail("shaker.set", "gone")
        with pytest.raises(DeviceError, match="port is gone"):
            await prove_enable_line(fake.rig, table, clock, 5.0, 2.0)
        assert table.observer.proof == "untried"

    run(scenario)


def test_it_moves_no_further_than_the_campaign():
    async def scenario(fake: FakeRig, table: Table, clock: SimulatedClock) -> None:
        await prove_enable_line(fake.rig, table, clock, 5.0, 0.1)
        assert fake.world.amplitude_mm == 0.1

    run(scenario)


def test_it_takes_a_line_and_something_that_sees():
    fake = fake_rig(SimulatedClock())
    assert can_prove_enable_line(fake.rig)
    assert not can_prove_enable_line(replace(fake.rig, gauges=()))
    assert not can_prove_enable_line(replace(fake.rig, trigger=None))
    assert not can_prove_enable_line(replace(fake.rig, shaker=None))
