"""The table as a capture needs it: at its excitation and settled, or at rest, and still so when the shutters close."""

from __future__ import annotations

import asyncio
import math
from functools import partial
from typing import Protocol

from labdaemon.capture.abilities import AmplitudeTrimmer
from labdaemon.capture.devices import GaugeReading
from labdaemon.capture.rig import Rig
from labdaemon.capture.settle import Excitation, SettlingResult, settling_time_s, wait_settled
from labdaemon.capture.table_evidence import TableState
from labdaemon.capture.table_observer import TableObserver
from labdaemon.capture.table_stop import PATIENCE_S, RestConfirmation, bring_to_rest
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError, InterlockError, RestUnconfirmed

SET_S = 60.0
"""A ramp between two excitations takes this long at most."""

TRIM_WITHIN = 0.01
"""The table's amplitude is corrected until the gauge agrees to this, relative."""

TRIM_TRIES = 3  # a calibration is off by some per cent, which one correction removes
FREQUENCY_WITHIN = 1e-3  # generators round to a millihertz at most
AMPLITUDE_WITHIN = 0.02  # what the level's own rounding and the calibration leave


def displacement_mm(reading: GaugeReading, unit: str, frequency_hz: float) -> float:
    """A gauge's amplitude as displacement; an accelerometer's is divided by (2πf)²."""
    if unit == "m/s2":
        return 1000.0 * reading.value / (2.0 * math.pi * frequency_hz) ** 2
    return reading.value


def _trim(driver: object, factor: float) -> None:
    assert isinstance(driver, AmplitudeTrimmer)
    driver.trim(factor)


class MotionGuard(Protocol):
    """A process of its own that stops the table when this one dies."""

    def arm(self) -> None:
        """The table is about to move; what this raises keeps it at rest."""
        ...


class Table:
    """The shaker table and what stands on it.

    Parameters
    ----------
    rig
        Its devices.
    clock
        For waits.
    disagreement
        Largest relative difference between amplitude set and read by the table gauge; None for no check.
    """

    def __init__(self, rig: Rig, clock: Clock, disagreement: float | None) -> None:
        self._rig, self._clock, self._disagreement = rig, clock, disagreement
        self._stops = 0
        self._stopping = asyncio.Lock()
        self._last_hz: float | None = None
        self.enabled: bool = False
        """Whether the enable line is up, as far as we know."""
        self.excitation: Excitation | None = None
        """What it was last set to; None at rest."""
        self.settled: SettlingResult | None = None
        """What the gauges said when it had settled there."""
        self.guard: MotionGuard | None = None
        """Is armed before the first command that moves the table; None where no guardian can be had."""
        self.may_move: bool = True
        """False once rest was confirmed, until something is sent that moves it: what a guardian goes by."""
        self.observer: TableObserver = TableObserver(rig, clock)
        self.unconfirmed: RestUnconfirmed | None = None
        """What the latest stop was that nothing confirmed; None once the table was seen to rest."""

    @property
    def state(self) -> TableState | None:
        """``moving`` while it is set to move, else what is seen of it; None without a shaker of ours."""
        if self._rig.shaker is None:
            return None
        return "moving" if self.excitation is not None else self.observer.state()

    @property
    def is_stopping(self) -> bool:
        """Whether a stop is in progress."""
        return self._stopping.locked()

    async def shake(self, excitation: Excitation) -> SettlingResult:
        """Bring table and structure to this excitation and wait until they have settled.

        Raises
        ------
        DeviceError
            The shaker did not take it, or the structure does not settle.
        InterlockError
            The table gauge reads another amplitude than was set, or somebody stopped the table meanwhile.
        """
        if self._rig.shaker is None:
            raise DeviceError("the rig has no shaker, so nothing can be set", device="shaker")
        if excitation == self.excitation and self.settled is not None:
            return self.settled
        stops = self._stops
        for trial in range(1, TRIM_TRIES + 1):
            await self._set(excitation)
            settled = await wait_settled(self._rig, excitation, self._clock)
            self._refuse_if_stopped(stops)
            ratio = self._table_ratio(settled, excitation)
            if ratio is None or abs(ratio - 1.0) <= TRIM_WITHIN:
                break
            trimmer: object = self._rig.shaker.driver
            if not isinstance(trimmer, AmplitudeTrimmer) or trial == TRIM_TRIES or not 0.5 < ratio < 2.0:
                break
            await self._rig.shaker.call(partial(_trim, factor=ratio))
        if ratio is not None and self._disagreement is not None and abs(ratio - 1.0) > self._disagreement:
            raise InterlockError(
                f"table gauge reads {ratio * excitation.amplitude_mm:.3g} mm where {excitation.amplitude_mm:.3g} mm "
                "was set; check gauge, amplifier gain and drive table"
            )
        self.settled = settled
        return settled

    async def rest(self) -> None:
        """Ramp the table down and wait until the structure has stopped ringing."""
        if self._rig.shaker is None:
            return
        last_hz = self._last_hz
        await self.stop()
        if last_hz is not None:
            await self._clock.sleep(settling_time_s(last_hz, 0.01))
            self._last_hz = None

    async def stop(self, *, at_once: bool = False, patience_s: float = PATIENCE_S) -> RestConfirmation:
        """Bring the table to rest now, whatever it is doing, and see that it rests; see `bring_to_rest`.

        Raises
        ------
        RestUnconfirmed
            Nothing confirmed within `patience_s`.
        """
        self._stops += 1
        self.excitation = self.settled = None
        async with self._stopping:
            try:
                rest = await bring_to_rest(
                    self._rig, self.observer, self._clock, at_once=at_once, patience_s=patience_s
                )
                self.may_move = self.excitation is not None
            except RestUnconfirmed as exc:
                self.unconfirmed = exc
                raise
            finally:
                if self.observer.line_down:
                    self.enabled = False
        self.unconfirmed = None
        return rest

    async def excite(self, excitation: Excitation) -> None:
        """Bring the table to this excitation, without waiting until the structure has settled.

        Raises
        ------
        DeviceError
            The shaker did not take it.
        InterlockError
            Somebody stopped the table meanwhile.
        """
        await self._set(excitation)

    async def drop_line(self) -> None:
        """Drop the enable line alone, on purpose: the shaker's output stays as it is."""
        if self._rig.trigger is None:
            return
        self.enabled = False  # before it is down, so that no heartbeat finds it so
        await self._rig.trigger.urgent(lambda driver: driver.drop_enable())
        self.observer.line_down = True

    async def confirm(self) -> None:
        """Ask the controller whether it still does what it was set to.

        Raises
        ------
        DeviceError
            It does not, so a capture taken meanwhile is worthless.
        """
        if self._rig.shaker is None or self.excitation is None:
            return
        asked = self.excitation
        state = await self._rig.shaker.call(lambda driver: driver.state())
        if (
            not state.running
            or abs(state.frequency_hz - asked.frequency_hz) > FREQUENCY_WITHIN * asked.frequency_hz
            or abs(state.amplitude_mm - asked.amplitude_mm) > AMPLITUDE_WITHIN * asked.amplitude_mm
        ):
            self.excitation = self.settled = None
            raise DeviceError(
                f"no longer shakes at {asked.frequency_hz:g} Hz and {asked.amplitude_mm:g} mm but "
                f"{'at' if state.running else 'rests; last'} {state.frequency_hz:g} Hz and {state.amplitude_mm:g} mm; "
                "somebody or something stopped it",
                device=self._rig.shaker.driver.name,
            )

    async def _set(self, excitation: Excitation) -> None:
        assert self._rig.shaker is not None
        stops = self._stops
        async with self._stopping:
            pass  # a stop in progress comes first
        self._refuse_if_stopped(stops)
        if self.unconfirmed is not None:
            raise DeviceError(
                f"nothing is moved before the table was seen to rest: {self.unconfirmed}", device="shaker"
            )
        if self.guard is not None:
            self.guard.arm()
        self.may_move = True
        await self._enable()
        self.excitation, self.settled = excitation, None
        self._last_hz = self.observer.frequency_hz = excitation.frequency_hz
        self.observer.forget()
        await self._rig.shaker.call(lambda driver: driver.set(excitation.frequency_hz, excitation.amplitude_mm), SET_S)
        self._refuse_if_stopped(stops)

    async def _enable(self) -> None:
        """Raise the enable line if it is down, with the output off: the table must not jump."""
        if self.enabled or self._rig.trigger is None or self._rig.shaker is None:
            return
        await self._rig.shaker.call(lambda driver: driver.stop_now())
        await self._rig.trigger.call(lambda driver: driver.raise_enable())
        self.enabled, self.observer.line_down = True, False

    def _refuse_if_stopped(self, stops: int) -> None:
        if self._stops != stops:
            raise InterlockError("the table was stopped while it was being set")

    def _table_ratio(self, settled: SettlingResult, excitation: Excitation) -> float | None:
        gauge = self._rig.gauge("table")
        if gauge is None or settled.table is None:
            return None
        return displacement_mm(settled.table, gauge.driver.unit, excitation.frequency_hz) / excitation.amplitude_mm
