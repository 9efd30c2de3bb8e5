from __future__ import annotations

import asyncio

import pytest

from labdaemon.capture.devices import GaugeReading
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table, displacement_mm
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, InterlockError, RestUnconfirmed
from labdaemon.testing.rig import fake_rig

QUICK = Excitation(5.0, 1.0, max_change_per_cycle=0.5)


def run(scenario):
    clock = SimulatedClock()
    fake = fake_rig(clock)
    table = Table(fake.rig, clock, 0.2)

    async def beat() -> None:
        while True:
            if table.enabled and fake.world.is_enabled():
                fake.trigger.heartbeat()
            await clock.sleep(0.4)

    async def main() -> None:
        beating = asyncio.create_task(beat())
        try:
            await scenario(fake, table, clock)
        finally:
            beating.cancel()

    clock.run(main())


def test_the_enable_line_is_raised_with_the_output_off():
    async def scenario(fake, table, clock):
        done: list[str] = []
        fake.world.on_call = done.append
        await table.shake(QUICK)
        told = [name for name in done if name.split(".")[1] in ("stop_now", "raise_enable", "set")]
        assert told == ["shaker.stop_now", "trigger.raise_enable", "shaker.set"]
        assert fake.world.moves()

    run(scenario)


def test_the_same_excitation_is_not_set_again():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        done: list[str] = []
        fake.world.on_call = done.append
        await table.shake(QUICK)
        assert done == []

    run(scenario)


def test_somebody_elses_stop_is_noticed():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        await table.confirm()
        fake.world.drive(False, 5.0, 1.0)
        with pytest.raises(DeviceError, match="no longer shakes at 5 Hz"):
            await table.confirm()
        assert table.excitation is None

    run(scenario)


def test_a_stop_while_it_is_being_set_wins():
    async def scenario(fake, table, clock):
        shaking = asyncio.create_task(table.shake(QUICK))
        await clock.sleep(0.5)
        await table.stop()
        with pytest.raises(InterlockError, match="stopped while it was being set"):
            await shaking
        assert not fake.world.running

    run(scenario)


def test_a_gauge_that_disagrees_stops_it():
    async def scenario(fake, table, clock):
        fake.gauges[0].gain = 0.7
        with pytest.raises(InterlockError, match=r"reads 0\.7 mm where 1 mm was set"):
            await table.shake(QUICK)

    run(scenario)


def test_an_accelerometer_counts_as_displacement():
    # 1 mm at 5 Hz is (2 pi 5)^2 mm/s2 = 0.987 m/s2
    assert displacement_mm(GaugeReading(0.98696, 0.0, 0.0, 0.0), "m/s2", 5.0) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(
    ("faults", "by"),
    [
        ({}, "soft"),
        ({"shaker.stop": "gone"}, "hard"),
        ({"shaker.stop": "silent", "shaker.stop_now": "refused"}, "enable"),
    ],
)
def test_the_ways_to_rest_in_their_order(faults, by):
    async def scenario(fake, table, clock):
        table.observer.proof = "proven"
        await table.shake(QUICK)
        for operation, kind in faults.items():
            fake.world.fail(operation, kind)
        rest = await table.stop()
        assert rest.by == by
        assert len(rest.troubles) == len(faults)
        assert not fake.world.moves()
        assert table.state == "rest"

    run(scenario)


def test_a_line_that_was_never_proven_is_no_rest():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        fake.world.fail("shaker.stop", "gone")
        fake.world.fail("shaker.stop_now", "refused", "refused")
        rest = await table.stop()
        assert rest.by == "hard"  # in the third round: the box's own answer was not enough
        assert len(rest.troubles) == 2

    run(scenario)


def test_when_nothing_confirms_it_says_to_use_the_emergency_stop():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        for operation in ("shaker.stop", "shaker.stop_now", "shaker.state", "trigger.drop_enable", "table.read"):
            fake.world.fail(operation, *["gone"] * 50)
        began = clock.monotonic()
        with pytest.raises(RestUnconfirmed, match="use the emergency stop") as caught:
            await table.stop()
        assert caught.value.table == "unconfirmed"
        assert 5.0 <= clock.monotonic() - began < 8.0
        assert table.state == "unconfirmed"
        with pytest.raises(DeviceError, match="nothing is moved before the table was seen to rest"):
            await table.shake(QUICK)

    run(scenario)


def test_a_table_that_its_gauge_sees_moving_is_not_at_rest():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        fake.world.deaf = True
        with pytest.raises(RestUnconfirmed, match="THE TABLE MOVES ON") as caught:
            await table.stop()
        assert caught.value.table == "moving"
        assert table.state == "moving"
        fake.world.deaf = False
        assert (await table.stop()).by == "soft"

    run(scenario)


def test_a_stop_waits_for_nothing_that_does_not_answer():
    async def scenario(fake, table, clock):
        await table.shake(QUICK)
        for operation in ("trigger.drop_enable", "trigger.heartbeat", "table.read", "shaker.state"):
            fake.world.fail(operation, *["silent"] * 20)
        asked_s = clock.monotonic()
        with pytest.raises(RestUnconfirmed):
            await table.stop()
        assert min(at_s for at_s in fake.world.stopped_at if at_s >= asked_s) - asked_s <= 0.1

    run(scenario)
