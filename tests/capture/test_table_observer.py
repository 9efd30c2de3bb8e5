"""What is seen of the table: who is asked, how long it counts, and what noise is."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import pytest

from labdaemon.capture.devices import GaugeReading
from labdaemon.capture.table_observer import FRESH_S, TableObserver
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, TransportError
from labdaemon.testing.gauge import FakeGauge
from labdaemon.testing.rig import FakeRig, fake_rig

Scenario = Callable[[FakeRig, TableObserver, SimulatedClock], Coroutine[Any, Any, None]]


def run(scenario: Scenario, change: Callable[[FakeRig], None] = lambda fake: None) -> None:
    clock = SimulatedClock()
    fake = fake_rig(clock)
    change(fake)
    clock.run(scenario(fake, TableObserver(fake.rig, clock), clock))


def shake(fake: FakeRig) -> None:
    fake.trigger.raise_enable()
    fake.shaker.set(5.0, 2.0)


def test_a_table_that_nothing_looked_at_is_unconfirmed() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        assert observer.state() == "unconfirmed"
        await observer.look()
        assert observer.state() == "rest"

    run(scenario)


def test_motion_is_seen_by_controller_and_gauge() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        shake(fake)
        evidence = await observer.look(gauge=False)
        assert (evidence.output_on, evidence.gauge_moves) == (True, None)
        assert observer.frequency_hz == 5.0, "where the gauge looks from now on"
        fake.trigger.heartbeat()
        await observer.look()
        assert observer.evidence().gauge_moves is True
        assert observer.state() == "moving"

    run(scenario)


def test_what_was_seen_longer_ago_says_nothing_of_now() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        await observer.query_shaker()
        await clock.sleep(FRESH_S - 0.5)
        assert observer.state() == "rest"
        await clock.sleep(1.0)
        assert observer.state() == "unconfirmed"
        await observer.query_shaker()
        observer.forget()
        assert observer.state() == "unconfirmed"

    run(scenario)


def test_a_controller_that_does_not_answer_saw_nothing() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        await observer.query_shaker()
        fake.world.fail("shaker.state", "rubbish")
        assert isinstance(await observer.query_shaker(), DeviceError)
        assert observer.evidence().output_on is None

    run(scenario)


def test_without_the_devices_there_is_nothing_to_ask() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        assert await observer.query_shaker() is None
        assert await observer.query_trigger() is None
        assert await observer.query_gauge() is None
        assert not observer.has_line
        assert observer.state() == "unconfirmed"

    def bare(fake: FakeRig) -> None:
        fake.rig = replace(fake.rig, shaker=None, trigger=None, gauges=())

    run(scenario, bare)


@pytest.mark.parametrize(("fault", "line_down"), [(None, False), ("refused", True), ("gone", None)])
def test_the_enable_line_is_what_the_box_said_last(fault: Any, line_down: bool | None) -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        fake.trigger.raise_enable()
        if fault is not None:
            fake.world.fail("trigger.heartbeat", fault)
        trouble = await observer.query_trigger()
        assert observer.line_down is line_down
        assert isinstance(trouble, TransportError) is (fault == "gone")

    run(scenario)


def test_a_slow_table_is_not_looked_at_with_the_gauge() -> None:
    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        observer.frequency_hz = 0.2
        assert await observer.query_gauge() is None
        assert observer.evidence().gauge_moves is None
        assert clock.monotonic() == 0.0

    run(scenario)


def test_one_record_of_noise_is_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only several in a row are: the first reads high, the next does not."""
    readings = [GaugeReading(0.01, 0.002, 0.0, 0.0), GaugeReading(0.001, 0.002, 0.0, 0.0)]
    monkeypatch.setattr(FakeGauge, "read", lambda gauge, frequency_hz, *, duration_s: readings.pop(0))

    async def scenario(fake: FakeRig, observer: TableObserver, clock: SimulatedClock) -> None:
        await observer.query_shaker()  # read back at rest: the gauge's noise can be learned
        observer.frequency_hz = 5.0
        await observer.query_gauge()
        assert observer.evidence().gauge_moves is False
        assert readings == []

    run(scenario)
