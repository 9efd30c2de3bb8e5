"""Requests and interlocks on their way to the running step."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from labdaemon.campaign.run_control import RunControl, StepInterruption
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, InterlockError

Scenario = Callable[[RunControl, asyncio.Task[None]], Coroutine[Any, Any, None]]


def run(scenario: Scenario) -> float:
    """Run a scenario with a control and a monitor that watches for ever; the time that passed, seconds."""
    clock = SimulatedClock()

    async def main() -> None:
        monitor: asyncio.Task[None] = asyncio.create_task(asyncio.sleep(1e6))
        await scenario(RunControl(), monitor)
        monitor.cancel()

    clock.run(main())
    return clock.monotonic()


def test_a_step_runs_to_its_end() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        assert not control.is_running_step
        step = asyncio.create_task(control.run_step(asyncio.sleep(5.0), monitor))
        await asyncio.sleep(1.0)
        assert control.is_running_step
        await step
        assert not control.is_running_step

    assert run(scenario) == pytest.approx(5.0)


def test_a_request_leaves_the_step_at_once_while_nothing_is_in_flight() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        asyncio.get_running_loop().call_later(2.0, control.request, "pause", "asked for")
        with pytest.raises(StepInterruption):
            await control.run_step(asyncio.sleep(100.0), monitor)
        assert (control.requested, control.reason) == ("pause", "asked for")

    assert run(scenario) == pytest.approx(2.0)


def test_a_request_waits_for_open_shutters() -> None:
    """Frames that are exposed are worth keeping."""

    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        async def capture() -> None:
            control.capture_started()
            await asyncio.sleep(10.0)
            control.capture_ended()
            await asyncio.sleep(100.0)

        asyncio.get_running_loop().call_later(2.0, control.request, "abort", "asked for")
        with pytest.raises(StepInterruption):
            await control.run_step(capture(), monitor)

    assert run(scenario) == pytest.approx(10.0)


@pytest.mark.parametrize("kind", ["stop", "interlock"])
def test_a_stop_and_an_interlock_wait_for_nothing(kind: str) -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        async def capture() -> None:
            control.capture_started()
            await asyncio.sleep(10.0)

        act = (
            (lambda: control.request("pause", "stopped", at_once=True))
            if kind == "stop"
            else (lambda: control.trip(InterlockError("too large")))
        )
        asyncio.get_running_loop().call_later(2.0, act)
        with pytest.raises(StepInterruption if kind == "stop" else InterlockError):
            await control.run_step(capture(), monitor)
        assert control.no_capture_in_flight.is_set(), "cameras may be asked again"

    assert run(scenario) == pytest.approx(2.0)


def test_what_fails_in_the_step_comes_out_as_it_was() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        async def fail() -> None:
            raise DeviceError("no answer", device="left")

        with pytest.raises(DeviceError, match="left: no answer"):
            await control.run_step(fail(), monitor)

    run(scenario)


def test_without_the_interlock_monitor_no_step_goes_on() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        async def fail() -> None:
            await asyncio.sleep(1.0)
            raise RuntimeError("the monitor has failed")

        ended = []

        async def step() -> None:
            try:
                await asyncio.sleep(100.0)
            finally:
                ended.append(True)

        with pytest.raises(RuntimeError, match="the monitor has failed"):
            await control.run_step(step(), asyncio.create_task(fail()))
        assert ended == [True]

    assert run(scenario) == pytest.approx(1.0)


def test_a_wait_ends_with_a_change_or_in_time() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        asyncio.get_running_loop().call_later(3.0, control.changed.set)
        await control.wait(monitor)
        assert not control.changed.is_set()
        await control.wait(monitor, 4.0)

    assert run(scenario) == pytest.approx(7.0)


def test_a_resumed_campaign_begins_anew() -> None:
    async def scenario(control: RunControl, monitor: asyncio.Task[None]) -> None:
        control.request("pause", "asked for")
        control.trip(InterlockError("too large"))
        control.clear()
        assert (control.requested, control.reason, control.tripped) == ("go", None, None)
        await control.run_step(asyncio.sleep(1.0), monitor)

    run(scenario)
