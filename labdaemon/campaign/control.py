"""What somebody wants of the campaign under way, and how the step that is being walked gets to notice.

A step is walked as a task of its own. A wish (pause, abort) cancels it at once, unless shutters are open: then that
capture is seen to its end first. An interlock and a stop cancel it whatever it is doing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, Literal

from labdaemon.errors import LabdaemonError

Wish = Literal["go", "pause", "abort"]


class Interrupted(Exception):
    """The step was left because somebody wanted the campaign paused or aborted."""


class Control:
    """Wishes and interlocks on their way to the step under way."""

    def __init__(self) -> None:
        self.wish: Wish = "go"
        self.reason: str | None = None
        """Why, for whoever asks."""
        self.tripped: LabdaemonError | None = None
        """What the guard ended the step for; None if it did not."""
        self.news = asyncio.Event()
        """Something may be different now: look again."""
        self.quiet = asyncio.Event()
        """Set while no shutters are open and no frames are on their way."""
        self.quiet.set()
        self._walking: asyncio.Task[None] | None = None

    @property
    def is_walking(self) -> bool:
        """Whether a step is under way."""
        return self._walking is not None

    def clear(self, wish: Wish = "go") -> None:
        """Begin afresh with this wish."""
        self.wish, self.reason, self.tripped = wish, None, None
        self.news.set()

    def want(self, wish: Wish, reason: str, *, at_once: bool = False) -> None:
        """Have the step left; `at_once` does not wait for open shutters."""
        self.wish, self.reason = wish, reason
        self.news.set()
        if self._walking is not None and (at_once or self.quiet.is_set()):
            self._walking.cancel()

    def trip(self, error: LabdaemonError) -> None:
        """Have the step left at once, as by this error."""
        self.tripped = error
        if self._walking is not None:
            self._walking.cancel()

    def begun(self) -> None:
        """Shutters are about to open."""
        self.quiet.clear()

    def ended(self) -> None:
        """The capture is stored, or came to nothing; if somebody waited for that, the step is left now."""
        self.quiet.set()
        if self.wish != "go" and self._walking is not None:
            self._walking.cancel()

    async def walk(self, steps: Coroutine[Any, Any, None], guard: asyncio.Task[None]) -> None:
        """Walk to the end.

        Raises
        ------
        Interrupted
            Somebody wanted something else.
        LabdaemonError
            The step failed, or the guard tripped.
        """
        self.tripped = None
        task = self._walking = asyncio.create_task(steps)
        try:
            await asyncio.wait({task, guard}, return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                guard.result()  # without a guard nothing may move
        finally:
            if not task.done():
                task.cancel()
                await asyncio.wait({task})
            self._walking = None
            self.quiet.set()
        if self.tripped is not None:
            raise self.tripped
        if task.cancelled():
            raise Interrupted
        task.result()

    async def wait(self, guard: asyncio.Task[None], timeout_s: float | None = None) -> None:
        """Wait for news, or for this long; raises what ended the guard, if it has ended."""
        news = asyncio.create_task(self.news.wait())
        try:
            await asyncio.wait({news, guard}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            news.cancel()
        if guard.done():
            guard.result()
        self.news.clear()
