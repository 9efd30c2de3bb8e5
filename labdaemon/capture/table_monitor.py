"""Watches what stops the table, in every state: shaker and trigger answer, and a table at rest rests.

It runs from the daemon's first moment to its last, campaign or none. A wire that is lost is a fault within three
seconds, is opened anew each second, and stops a moving table; a stop that nothing confirmed is tried again each second.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from typing import Any, Protocol

from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.capture.table import Table
from labdaemon.capture.table_stop import CONNECT_S, rest_unconfirmed
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError, LabdaemonError, RestUnconfirmed

log: logging.Logger = logging.getLogger(__name__)

ROUND_S = 0.7  # what was seen stays fresh for several rounds
SECOND_ASK_S = 0.15
"""After a first miss it is asked again so soon: two misses make a loss within three seconds."""
MISSES = 2  # one answer may be lost on any wire
IN_A_ROW = 3
"""Rounds in which something unexpected must be seen, before it is no moment between two commands."""
GAUGE_ROUNDS = 3
"""A table at rest is looked at with the gauge in one round of so many."""


class FaultObserver(Protocol):
    """Learns of faults of the devices that stop the table."""

    def report(self, error: LabdaemonError, action: str) -> None:
        """A fault, and what is done about it."""
        ...

    def trip(self, error: LabdaemonError) -> None:
        """A wire was lost while the table moves: leave the campaign and stop the table."""
        ...


class FaultLog:
    """Writes faults to the log, as long as no campaign can be left."""

    def report(self, error: LabdaemonError, action: str) -> None:
        log.error("%s (%s)", error, action)

    def trip(self, error: LabdaemonError) -> None:
        """Nothing of ours moves the table yet."""


class TableMonitor:
    """Watches the wires that stop the table.

    Parameters
    ----------
    rig, table, clock
        What is kept, and how time passes.

    Attributes
    ----------
    observer
        Learns of every fault; the log alone at first.
    lost
        Names of the devices that do not answer.
    """

    def __init__(self, rig: Rig, table: Table, clock: Clock) -> None:
        self._rig, self._table, self._clock = rig, table, clock
        self.observer: FaultObserver = FaultLog()
        self.lost: set[str] = set()
        self._misses: dict[str, int] = {}
        self._rounds = self._rounds_up = self._rounds_moving = 0

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            missed = await self.poll()
            await self._clock.sleep(SECOND_ASK_S if missed else ROUND_S)

    async def poll(self) -> bool:
        """One round; whether a device did not answer that is not yet given up as lost."""
        self._rounds += 1
        await asyncio.gather(self._check_shaker(), self._check_trigger(), self._check_gauge())
        await self._check_rest()
        return any(0 < misses < MISSES for misses in self._misses.values())

    async def _check_shaker(self) -> None:
        shaker = self._rig.shaker
        if shaker is None:
            return
        exc = await self._table.observer.query_shaker()
        if not self._becomes_lost(shaker, exc):
            return
        assert exc is not None
        moving = self._table.excitation is not None
        self.observer.report(_lost(exc, shaker, moving), "stop the table" if moving else "open it anew")
        if moving:
            self.observer.trip(exc)
        elif self._table.unconfirmed is None:  # read back or not, it must be seen again
            self._table.unconfirmed = rest_unconfirmed(self._table.observer.evidence(), [str(exc)])

    async def _check_trigger(self) -> None:
        trigger = self._rig.trigger
        if trigger is None:
            return
        name = trigger.driver.name
        if name in self.lost:
            await self._reconnect(trigger)
            return
        exc = await self._table.observer.query_trigger()
        if self._becomes_lost(trigger, exc):
            assert exc is not None
            self.observer.report(_lost(exc, trigger, self._table.excitation is not None), "open it anew")
        # Up although nothing of ours raised it: an earlier process did, and the question itself holds it up. A line
        # that is just being raised is up for less than a round.
        table = self._table
        is_foreign = table.observer.line_down is False and not table.enabled and table.excitation is None
        self._rounds_up = self._rounds_up + 1 if exc is None and table.observer.has_line and is_foreign else 0
        if self._rounds_up >= IN_A_ROW:
            await self._drop(trigger)

    async def _drop(self, trigger: DeviceHandle[Any]) -> None:
        try:
            await trigger.urgent(lambda driver: driver.drop_enable())
        except LabdaemonError as exc:
            log.warning("%s", exc)
        else:
            self._table.observer.line_down = True

    async def _check_gauge(self) -> None:
        """Look at a resting table's own motion; a gauge that fell silent is connected to anew."""
        gauge = self._rig.gauge("table")
        if gauge is None or self._table.excitation is not None or self._rounds % GAUGE_ROUNDS:
            return
        if await self._table.observer.query_gauge() is None:
            return
        with suppress(LabdaemonError):  # it is asked again soon; a campaign that needs it says what is wrong
            await gauge.call(lambda driver: driver.connect(), CONNECT_S)

    def _becomes_lost(self, device: DeviceHandle[Any], exc: LabdaemonError | None) -> bool:
        """Count misses; True when it has just become lost."""
        name = device.driver.name
        if exc is None:
            self._misses.pop(name, None)
            if name in self.lost:
                self.lost.discard(name)
                log.warning("%s answers again", name)
            return False
        if not isinstance(exc, DeviceError) or name in self.lost:
            return False
        self._misses[name] = self._misses.get(name, 0) + 1
        if self._misses[name] < MISSES:
            return False
        self.lost.add(name)
        return True

    async def _reconnect(self, device: DeviceHandle[Any]) -> None:
        try:
            await device.urgent(lambda driver: driver.connect(), CONNECT_S)
        except LabdaemonError:
            return  # said once; it is tried again in the next round
        self.lost.discard(device.driver.name)
        self._misses.pop(device.driver.name, None)
        log.warning("%s was opened anew and answers again", device.driver.name)

    async def _check_rest(self) -> None:
        """A table that should rest: stopped again where nothing confirmed it, reported where it moves by itself."""
        table = self._table
        if self._rig.shaker is None or table.excitation is not None:
            self._rounds_moving = 0
            return
        if table.unconfirmed is None:
            moves = table.state == "moving" and not table.is_stopping
            self._rounds_moving = self._rounds_moving + 1 if moves else 0
            if self._rounds_moving == IN_A_ROW:  # said once, and not fought: a person may be trying the shaker by hand
                self.observer.report(
                    DeviceError("the table moves although nothing of ours moves it; look at it"), "none"
                )
            return
        if table.is_stopping:
            return  # that stop tries by itself
        try:
            await table.stop(at_once=True, patience_s=0.0)
        except RestUnconfirmed:
            return  # reported by whoever stopped it first; status says it all the while
        log.warning("the table is seen at rest again")


def _lost(exc: LabdaemonError, device: DeviceHandle[Any], moving: bool) -> DeviceError:
    name = device.driver.name
    what = (
        "its table moves and is stopped by what is left; use the emergency stop if it moves on"
        if moving
        else ("use the emergency stop if the table moves")
    )
    return DeviceError(f"{str(exc).removeprefix(f'{name}: ')}; {what}", device=name)
