"""Watches the rig while a campaign runs, and trips the interlocks.

Five loops: the heartbeat that holds the amplifier's enable line, the gauges while the table moves, the data disk, the
measuring queue, and the cameras every half minute. The checks themselves are in `labdaemon.campaign.interlocks`.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Protocol

from labdaemon.campaign import interlocks
from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.interlocks import GaugeSample, InterlockLimits
from labdaemon.campaign.run_control import RunControl
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.devices import Gauge
from labdaemon.capture.rig import CALL_S, DeviceHandle
from labdaemon.capture.table import displacement_mm
from labdaemon.errors import DeviceError, DeviceRefused, InterlockError, LabdaemonError, StorageUnavailable

WATCH_CYCLES = 2.0  # a shorter record would mix the excitation with the gauge's offset
MISSES = 3
"""Readings or answers in a row that may be missing before a device counts as lost."""


@dataclass(frozen=True, slots=True)
class PollIntervals:
    """Seconds between two rounds of each loop. The enable line drops by itself after 1.5 s without a heartbeat."""

    heartbeat_s: float = 0.4
    gauges_s: float = 0.25
    room_s: float = 5.0
    cameras_s: float = 30.0


class InterlockObserver(Protocol):
    """Acts on what an `InterlockMonitor` sees."""

    def trip(self, error: LabdaemonError) -> None:
        """Stop the table. Another call while it is stopped does no harm.

        A crossed limit is an `InterlockError`, which waits for a person; a lost device's own `DeviceError` and a
        `StorageUnavailable` may pass.
        """
        ...


class Backlog(Protocol):
    """What waits to be measured."""

    def oldest_s(self) -> float:
        """How long the oldest capture has waited, seconds."""
        ...


@dataclass(slots=True)
class InterlockMonitor:
    """Runs the interlocks.

    Attributes
    ----------
    observer
        Stops the table.
    disk
        The data disk.
    backlog
        The captures that wait to be measured.
    control
        Knows whether a capture is in flight: cameras are asked nothing while they expose or deliver.
    iterations
        Rounds that the heartbeat loop has made: what a watchdog looks at.
    """

    context: AcquisitionContext
    limits: InterlockLimits
    observer: InterlockObserver
    disk: DataDisk
    backlog: Backlog
    control: RunControl
    intervals: PollIntervals = field(default_factory=PollIntervals)
    iterations: int = 0
    _misses: dict[str, int] = field(default_factory=dict)
    _seen: GaugeSample | None = None

    async def run(self) -> None:
        """Watch until cancelled."""
        async with asyncio.TaskGroup() as loops:
            loops.create_task(self._heartbeat())
            loops.create_task(self._gauges())
            loops.create_task(self._disk())
            loops.create_task(self._workers())
            loops.create_task(self._cameras())

    async def _heartbeat(self) -> None:
        trigger, table = self.context.rig.trigger, self.context.table
        while True:
            if trigger is not None and table.enabled:
                try:
                    await trigger.observe(lambda driver: driver.heartbeat(), self.intervals.heartbeat_s)
                except DeviceRefused as exc:
                    table.enabled, table.observer.line_down = False, True
                    if table.excitation is not None:
                        self.observer.trip(self._line_drop_error(trigger.driver.name, exc))
                except DeviceError as exc:
                    self._missed(trigger.driver.name, exc)
                else:
                    self._misses[trigger.driver.name] = 0
            self.iterations += 1
            await self.context.clock.sleep(self.intervals.heartbeat_s)

    def _line_drop_error(self, device: str, exc: DeviceRefused) -> LabdaemonError:
        """Why the enable line is down: a wire that was lost may be tried again, anything else waits for a person."""
        if self._misses.get(device, 0):
            self._misses[device] = 0
            return DeviceError("its enable line fell while its wire was lost", device=device)
        return InterlockError(f"the amplifier's enable line is down ({exc})")

    async def _gauges(self) -> None:
        while True:
            excitation = self.context.table.excitation
            if excitation is None:
                self._seen = None
            else:
                for gauge in self.context.rig.gauges:
                    await self._watch(gauge, excitation.frequency_hz)
            await self.context.clock.sleep(self.intervals.gauges_s)

    async def _watch(self, gauge: DeviceHandle[Gauge], frequency_hz: float) -> None:
        name, driver = gauge.driver.name, gauge.driver
        duration_s = max(WATCH_CYCLES / frequency_hz, self.intervals.gauges_s)
        try:
            reading = await gauge.call(lambda gauge: gauge.read(frequency_hz, duration_s=duration_s), CALL_S)
        except DeviceError as exc:
            self._missed(name, exc)
            return
        self._misses[name] = 0
        excitation = self.context.table.excitation
        if excitation is None or excitation.frequency_hz != frequency_hz:
            return  # it changed while the gauge was read
        scale = displacement_mm(reading, driver.unit, frequency_hz) / reading.value if reading.value else 1.0
        now = GaugeSample(self.context.clock.monotonic(), scale * reading.value, scale * reading.sd)
        violation = None
        if driver.role == "response":
            violation = interlocks.check_response(self.limits, now, self._seen)
            self._seen = now
        elif self.context.table.settled is not None:
            self.context.table.observer.learn_noise(reading, duration_s)
            violation = interlocks.check_table(self.limits, excitation.amplitude_mm, now)
        if violation is not None:
            self.observer.trip(InterlockError(violation.message))

    async def _disk(self) -> None:
        """A table that moves while nothing can be recorded is brought to rest."""
        while True:
            if self.context.table.excitation is not None:
                try:
                    await self.disk.check()
                except StorageUnavailable as exc:
                    self.observer.trip(exc)
            await self.context.clock.sleep(self.intervals.room_s)

    async def _workers(self) -> None:
        while True:
            if self.context.table.excitation is not None:
                violation = interlocks.check_workers(self.limits, self.backlog.oldest_s())
                if violation is not None:
                    self.observer.trip(InterlockError(violation.message))
            await self.context.clock.sleep(self.intervals.room_s)

    async def _cameras(self) -> None:
        while True:
            for name in self.context.rig.cameras:
                await self.control.no_capture_in_flight.wait()
                await self._check_camera(name)
            await self.context.clock.sleep(self.intervals.cameras_s)

    async def _check_camera(self, name: str) -> None:
        try:
            status = await self.context.rig.cameras[name].call(lambda driver: driver.status())
        except DeviceError as exc:
            self._missed(name, exc)
            return
        self._misses[name] = 0
        violation = interlocks.check_camera(self.limits, name, status)
        if violation is not None and self.context.table.excitation is not None:
            self.observer.trip(InterlockError(violation.message))

    def _missed(self, device: str, exc: DeviceError) -> None:
        self._misses[device] = self._misses.get(device, 0) + 1
        if self._misses[device] >= MISSES and self.context.table.excitation is not None:
            self.observer.trip(exc)
