"""The journal and the data disk on threads of their own, so that no fsync holds up an interlock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from labdaemon.capture.device_executor import DeviceExecutor
from labdaemon.journal.journal import Journal

P = ParamSpec("P")
T = TypeVar("T")

UNLIMITED_S = 1e9
"""A write that was given up might still reach the disk, and its repetition would be a second one: so each is waited
for, however long the disk takes. The interlock monitor sees to it that the table does not
move meanwhile."""


class CommitObserver(Protocol):
    """Follows what is committed."""

    def wake(self) -> None:
        """Something was committed; called on the event loop, so it only notes that it has to look."""
        ...


class Recorder:
    """Writes transitions and files, and reports when there is something to publish.

    Parameters
    ----------
    journal
        Read it directly; write through `write`.
    executor
        The journal's own thread.
    files, work
        The threads for files and for what only takes long; the journal's where there is no other.
    observers
        Who learns of each commit.
    """

    def __init__(
        self,
        journal: Journal,
        executor: DeviceExecutor,
        files: DeviceExecutor | None = None,
        work: DeviceExecutor | None = None,
        observers: Sequence[CommitObserver] = (),
    ) -> None:
        self.journal = journal
        self.observers: Sequence[CommitObserver] = tuple(observers)
        self._executor, self._files, self._work = executor, files or executor, work or executor

    async def write(self, transition: Callable[Concatenate[Journal, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Carry out one of `labdaemon.journal.transitions`; it is on the disk when this returns.

        Raises
        ------
        StorageUnavailable
            The disk does not take it now; nothing was written.
        """
        result = await self._executor.call(lambda: transition(self.journal, *args, **kwargs), UNLIMITED_S)
        for observer in self.observers:
            observer.wake()
        return result

    async def on_disk(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Do blocking work on files, after what was asked for before.

        Raises
        ------
        StorageError
            What the function raises.
        """
        return await self._files.call(lambda: function(*args, **kwargs), UNLIMITED_S)

    async def in_background(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Do work that takes long, a plan above all, off the event loop and out of the way of frames and records."""
        return await self._work.call(lambda: function(*args, **kwargs), UNLIMITED_S)

    async def wait_idle(self) -> None:
        """Wait until writes that were asked for before are done, also those that their callers no longer wait for."""
        await self._executor.call(lambda: None, UNLIMITED_S)
        await self._files.call(lambda: None, UNLIMITED_S)

    def close(self) -> None:
        """End the threads; the journal itself is its owner's."""
        self._executor.close()
        self._files.close()
        self._work.close()
