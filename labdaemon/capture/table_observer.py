"""Observes the table: asks every device that can see whether it moves, and remembers what was seen and when."""

from __future__ import annotations

import asyncio
import math
from typing import Literal

from labdaemon.capture.abilities import holds_enable_line
from labdaemon.capture.devices import GaugeReading, ShakerState
from labdaemon.capture.rig import OBSERVE_S, Rig
from labdaemon.capture.table_evidence import TableEvidence, TableState, gauge_sees_motion, judge
from labdaemon.clock import Clock
from labdaemon.errors import DeviceRefused, LabdaemonError

FRESH_S = 4.0
"""What was seen longer ago says nothing of now: a few rounds of whoever keeps looking."""

SHORTEST_RECORD_S = 0.3  # below this a gauge of 50 readings a second has too few
LONGEST_RECORD_S = 3.0
"""A table so slow that one cycle takes longer is not looked at with the gauge."""

RECORDS = 3  # of noise alone one in a million passes three times
CLEAR_SDS = 10.0
"""A sine that stands out so far explains its record: what is left of it is the gauge's noise."""

EnableLineProof = Literal["untried", "proven", "failed"]


class TableObserver:
    """What is known of the table's motion.

    Parameters
    ----------
    rig
        Its devices.
    clock
        For the age of what was seen.

    Attributes
    ----------
    proof
        Whether the enable line was seen to end the table's motion, since this process began.
    line_down
        What the trigger box said last of the enable line; None when it never said.
    frequency_hz
        Of the table's motion as far as it is known: where the gauge looks for it.
    gauge_trouble
        What kept the table gauge from being read at the last look; None where it was read, or there is none.
    """

    def __init__(self, rig: Rig, clock: Clock) -> None:
        self._rig, self._clock = rig, clock
        self.proof: EnableLineProof = "untried"
        self.line_down: bool | None = None
        self.frequency_hz: float | None = None
        self.gauge_trouble: LabdaemonError | None = None
        self._shaker: tuple[float, ShakerState] | None = None
        self._gauge: tuple[float, bool] | None = None
        self._noise: float | None = None
        """Smallest sd of the gauge times the square root of its record's length, mm·√s."""

    @property
    def has_line(self) -> bool:
        """Whether a trigger device of ours holds an enable line."""
        trigger = self._rig.trigger
        return trigger is not None and holds_enable_line(trigger.driver)

    def evidence(self) -> TableEvidence:
        """What was seen lately."""
        now_s = self._clock.monotonic()
        shaker = self._shaker[1] if self._shaker is not None and now_s - self._shaker[0] < FRESH_S else None
        gauge = self._gauge[1] if self._gauge is not None and now_s - self._gauge[0] < FRESH_S else None
        return TableEvidence(
            output_on=shaker.running if shaker is not None else None,
            amplifier_on=shaker.amplifier_on if shaker is not None else None,
            gauge_moves=gauge,
            line_down=self.line_down if self.has_line else None,
            line_proven=self.proof == "proven",
        )

    def state(self) -> TableState:
        """The verdict on what was seen lately."""
        return judge(self.evidence())

    def forget(self) -> None:
        """The table is about to be changed: what was seen before says nothing any more."""
        self._shaker = self._gauge = None

    async def look(self, *, gauge: bool = True) -> TableEvidence:
        """Ask all that can see, at once; who does not answer saw nothing."""
        await asyncio.gather(self.query_shaker(), self.query_gauge() if gauge else _nothing())
        return self.evidence()

    async def query_shaker(self) -> LabdaemonError | None:
        """Ask the controller; what was wrong with its answer, None if nothing was."""
        if self._rig.shaker is None:
            return None
        try:
            state = await self._rig.shaker.observe(lambda driver: driver.state())
        except LabdaemonError as exc:
            self._shaker = None
            return exc
        self._shaker = self._clock.monotonic(), state
        if state.running and math.isfinite(state.frequency_hz):
            self.frequency_hz = state.frequency_hz
        return None

    async def query_trigger(self) -> LabdaemonError | None:
        """Ask the trigger device, which holds its line or says that it is down; what was wrong, None if nothing was."""
        trigger = self._rig.trigger
        if trigger is None:
            return None
        try:
            await trigger.observe(lambda driver: driver.heartbeat(), OBSERVE_S)
        except DeviceRefused:
            self.line_down = True
        except LabdaemonError as exc:  # the caller counts it; what the line is stays as it was known
            return exc
        else:
            self.line_down = False
        return None

    async def query_gauge(self) -> LabdaemonError | None:
        """See whether the table gauge sees motion, in records that begin now; what was wrong with it, None if nothing.

        One record of noise in a hundred reads above three standard deviations, so only several in a row are motion.
        """
        gauge, frequency_hz = self._rig.gauge("table"), self.frequency_hz
        self._gauge, self.gauge_trouble = None, None
        if gauge is None or frequency_hz is None or 1.0 / frequency_hz > LONGEST_RECORD_S:
            return None
        duration_s = min(max(2.0 / frequency_hz, SHORTEST_RECORD_S), LONGEST_RECORD_S)
        moves: bool | None = True
        for _ in range(RECORDS):
            await self._clock.sleep(duration_s)
            try:
                reading = await gauge.observe(
                    lambda driver: driver.read(frequency_hz, duration_s=duration_s), duration_s + OBSERVE_S
                )
            except LabdaemonError as exc:
                self.gauge_trouble = exc
                return exc  # silent, stuck or out of range: it sees nothing
            is_read_back_off = self._shaker is not None and not self._shaker[1].running
            if is_read_back_off or reading.value > CLEAR_SDS * reading.sd:
                self.learn_noise(reading, duration_s)
            noise_sd = None if self._noise is None else self._noise / math.sqrt(duration_s)
            moves = gauge_sees_motion(reading, noise_sd)
            if not moves:
                break
        self._gauge = None if moves is None else (self._clock.monotonic(), moves)
        return None

    def learn_noise(self, reading: GaugeReading, duration_s: float) -> None:
        """Learn the gauge's noise from a table that does what it was set to, or is read back at rest."""
        if reading.sd > 0:
            noise = reading.sd * math.sqrt(duration_s)
            self._noise = noise if self._noise is None else min(self._noise, noise)


async def _nothing() -> None:
    return None
