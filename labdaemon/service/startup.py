"""Between the table at rest and service: what is missing is waited for, as what is lost later is.

After a power cut the computer is up before its devices, and before a disk that must be checked first. So commands are
answered from the moment the socket is bound: ``status`` names what is waited for, ``stop`` stops the table, and what
needs the devices waits a little and is then refused by the name of what is missing.
"""

from __future__ import annotations

import asyncio
import errno
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from labdaemon.capture.rig import CALL_S, DeviceHandle, Rig
from labdaemon.capture.table import Table
from labdaemon.capture.table_evidence import describe
from labdaemon.clock import Clock
from labdaemon.errors import DeviceError, LabdaemonError, StorageError
from labdaemon.journal.journal import Journal
from labdaemon.journal.storage import JournalError
from labdaemon.off_loop import off_loop
from labdaemon.service.devices import CONNECT_S
from labdaemon.stream.dispatcher import Handler
from labdaemon.stream.messages import WrongStateError

T = TypeVar("T")

log: logging.Logger = logging.getLogger(__name__)

RETRY_S = 2.0
"""Between two tries of the same thing; each has a deadline of its own."""

DATA = "data folder"

PATH_ERRORS = (errno.ENAMETOOLONG, errno.ELOOP)
"""What is wrong with a path itself, and no wait mends."""

UNKNOWN_AT_START = (
    *("campaign", "name", "reason", "step", "steps", "label", "kind", "frequency_hz", "amplitude_mm"),
    *("captures", "captures_total", "left_s", "largest_mm", "largest_target", "doubtful", "doubtful_mm"),
)
"""Members of `status` that are not known before the engine runs."""

ExposureSteps = dict[str, tuple[float, ...]]


class EndRequest(Exception):
    """A person or systemd ends the daemon while it still waits."""


@dataclass(slots=True)
class StartupSequence:
    """Waits for disk and devices, and answers commands meanwhile.

    Attributes
    ----------
    place
        Which daemon this is, for ``status``.
    end
        Exit status, set when a person or systemd ends it.
    parts
        Tasks that run already; an error of theirs ends the wait.
    waiting_for
        What is missing, and what was said of it at the latest try.
    announce
        Called each time that a device is found missing: people and programs may ask why.
    checks
        What the watchdog looks at; nothing while it waits but that the event loop runs.
    """

    clock: Clock
    table: Table
    place: Mapping[str, Any]
    end: asyncio.Future[int]
    parts: list[asyncio.Task[Any]] = field(default_factory=list)
    waiting_for: dict[str, str] = field(default_factory=dict)
    announce: Callable[[], None] = lambda: None
    checks: dict[str, Callable[[], Awaitable[bool]]] = field(default_factory=dict)

    def status(self) -> dict[str, Any]:
        """What there is to say before the engine runs."""
        names = ", ".join(self.waiting_for)
        return {
            **dict.fromkeys(UNKNOWN_AT_START),
            "state": "starting",
            "doing": f"waiting for {names}" if names else "starting",
            "waiting_for": dict(self.waiting_for),
            "captures_manual": 0,
            "faults": 0,
            "last_fault": next(iter(self.waiting_for.values()), None),
            "queue": 0,
            "measuring": 0,
            "table": self.table.state,
            **self.place,
        }

    def handlers(self) -> dict[str, Handler]:
        """Commands that need neither devices nor journal."""

        async def status(params: dict[str, Any]) -> Any:
            return self.status()

        async def stop(params: dict[str, Any]) -> Any:
            rest = await self.table.stop()
            seen = describe(rest.seen) if self.table.state is not None else None
            return {"rest": rest.by, "table": self.table.state, "seen": seen, "troubles": list(rest.troubles)}

        return {"status": status, "stop": stop}

    def refusal(self) -> LabdaemonError:
        """Why a command cannot be carried out yet."""
        for name, why in self.waiting_for.items():
            if name != DATA:
                reason = why.removeprefix(f"{name}: ")
                return DeviceError(f"the daemon waits for it and serves when it is there ({reason})", device=name)
        return WrongStateError(f"the daemon is starting ({self.waiting_for.get(DATA, 'a moment')})")

    async def open_journal(self, folder: Path, replace_damaged: bool) -> Journal:
        """The journal of a data folder, as soon as there is a disk that takes it.

        Raises
        ------
        JournalError
            It is damaged, another daemon's or another program's: a person must decide.
        StorageError
            The folder can have no such name.
        EndRequest
            Before that.
        """

        def open_it() -> Journal:
            return Journal(folder, self.clock, replace_damaged=replace_damaged)

        while True:
            try:
                journal = await self._until(off_loop(open_it))
            except StorageError as exc:
                if isinstance(exc, JournalError) or getattr(exc.__cause__, "errno", None) in PATH_ERRORS:
                    raise
                self._note_missing(DATA, exc)
                await self._until(self.clock.sleep(RETRY_S))
            else:
                self._note_present(DATA)
                return journal

    async def reach_devices(self, rig: Rig, stop_actuators: Mapping[str, str]) -> tuple[dict[str, str], ExposureSteps]:
        """Every device's identity, and the exposure times that each body offers, as soon as all have answered.

        Parameters
        ----------
        rig
            All devices.
        stop_actuators
            Identities of shaker and trigger, where they have answered already.

        Raises
        ------
        EndRequest
            Before that.
        """
        found, steps = dict(stop_actuators), ExposureSteps()

        async def reach(name: str, device: DeviceHandle[Any], *, is_kept: bool = False) -> None:
            found[name] = str(await self._reach(name, device, lambda driver: driver.connect(), is_kept))

        async def reach_camera(name: str, device: DeviceHandle[Any]) -> None:
            info, steps[name] = await self._reach(
                name, device, lambda driver: (driver.connect(), driver.exposure_steps_s())
            )
            found[name] = f"{info.manufacturer} {info.model} {info.serial}"

        waits: list[Coroutine[Any, Any, None]] = [
            reach(name, device, is_kept=True)
            for name, device in (("trigger", rig.trigger), ("shaker", rig.shaker))
            if device is not None and name not in stop_actuators
        ]
        waits += [reach(gauge.driver.name, gauge) for gauge in rig.gauges]
        waits += [reach_camera(name, camera) for name, camera in rig.cameras.items()]
        await self._until(_all(waits))
        return found, steps

    async def _reach(self, name: str, device: DeviceHandle[Any], ask: Callable[[Any], T], is_kept: bool = False) -> T:
        """Try until it answers; what is kept by another part is not closed between two tries."""
        while True:
            try:
                answer = await device.call(ask, CONNECT_S)
            except DeviceError as exc:
                self._note_missing(name, exc)
            else:
                self._note_present(name)
                return answer
            await self.clock.sleep(RETRY_S)
            if not is_kept:
                with suppress(DeviceError):  # it is the new connection that counts
                    await device.call(lambda driver: driver.close(), CALL_S)

    async def _until(self, work: Awaitable[T]) -> T:
        """What the work gives, unless the end or an error of a running part comes first."""
        task = asyncio.ensure_future(work)
        others: list[asyncio.Future[Any]] = [self.end, *self.parts]
        try:
            await asyncio.wait([task, *others], return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            for part in self.parts:
                if part.done():
                    part.result()
            raise EndRequest
        finally:
            task.cancel()

    def _note_missing(self, name: str, exc: LabdaemonError) -> None:
        if name not in self.waiting_for:
            log.warning("waiting for %s: %s", name, str(exc).removeprefix(f"{name}: "))
        self.waiting_for[name] = str(exc)
        if name != DATA:
            self.announce()

    def _note_present(self, name: str) -> None:
        if self.waiting_for.pop(name, None) is not None:
            log.warning("%s is there now", name)


async def _all(waits: list[Coroutine[Any, Any, None]]) -> None:
    async with asyncio.TaskGroup() as tasks:
        for wait in waits:
            tasks.create_task(wait)
