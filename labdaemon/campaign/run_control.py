"""What persons and interlocks ask of the campaign in progress, and how the running step learns of it.

A step runs as a task of its own. A request (pause, abort) cancels it at once, unless shutters are open: then that
capture is seen to its end first. An interlock and a stop cancel it whatever it is doing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, Literal

from labdaemon.errors import LabdaemonError

RequestedState = Literal["go", "pause", "abort"]


class StepInterruption(Exception):
    """The step was left because a person asked for a pause or an abort."""


class RunControl:
    """Carries requests and interlocks to the running step."""

    def __init__(self) -> None:
        self.requested: RequestedState = "go"
        self.reason: str | None = None
        """Why, for status."""
        self.tripped: LabdaemonError | None = None
        """What the interlock monitor ended the step for; None if it did not."""
        self.changed: asyncio.Event = asyncio.Event()
        """Something may be different now: look again."""
        self.no_capture_in_flight: asyncio.Event = asyncio.Event()
        """Set while no shutters are open and no frames are on their way."""
        self.no_capture_in_flight.set()
        self._step_task: asyncio.Task[None] | None = None

    @property
    def is_running_step(self) -> bool:
        """Whether a step runs."""
        return self._step_task is not None

    def clear(self, requested: RequestedState = "go") -> None:
        """Begin anew with this requested state."""
        self.requested, self.reason, self.tripped = requested, None, None
        self.changed.set()

    def request(self, requested: RequestedState, reason: str, *, at_once: bool = False) -> None:
        """Have the step left; `at_once` does not wait for open shutters."""
        self.requested, self.reason = requested, reason
        self.changed.set()
        if self._step_task is not None and (at_once or self.no_capture_in_flight.is_set()):
            self._step_task.cancel()

    def trip(self, error: LabdaemonError) -> None:
        """Have the step left at once, as by this error."""
        self.tripped = error
        if self._step_task is not None:
            self._step_task.cancel()

    def capture_started(self) -> None:
        """Shutters are about to open."""
        self.no_capture_in_flight.clear()

    def capture_ended(self) -> None:
        """The capture is stored, or has failed; if a request waited for that, the step is left now."""
        self.no_capture_in_flight.set()
        if self.requested != "go" and self._step_task is not None:
            self._step_task.cancel()

    async def run_step(self, steps: Coroutine[Any, Any, None], monitor: asyncio.Task[None]) -> None:
        """Run to the end.

        Raises
        ------
        Interrupted
            A person asked for something else.
        LabdaemonError
            The step failed, or an interlock tripped.
        """
        self.tripped = None
        task = self._step_task = asyncio.create_task(steps)
        try:
            await asyncio.wait({task, monitor}, return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                monitor.result()  # without the interlock monitor nothing may move
        finally:
            if not task.done():
                task.cancel()
                await asyncio.wait({task})
            self._step_task = None
            self.no_capture_in_flight.set()
        if self.tripped is not None:
            raise self.tripped
        if task.cancelled():
            raise StepInterruption
        task.result()

    async def wait(self, monitor: asyncio.Task[None], timeout_s: float | None = None) -> None:
        """Wait for a change, or for this long; raises what ended the interlock monitor, if it has ended."""
        changed = asyncio.create_task(self.changed.wait())
        try:
            await asyncio.wait({changed, monitor}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            changed.cancel()
        if monitor.done():
            monitor.result()
        self.changed.clear()
