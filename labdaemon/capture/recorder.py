"""The journal on a line of its own, so that its fsync never holds up an interlock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

from labdaemon.capture.lines import Line
from labdaemon.journal.journal import Journal

P = ParamSpec("P")
T = TypeVar("T")

WRITE_S = 60.0
"""A commit that takes longer than this means a dying disk."""


class Recorder:
    """Writes transitions and tells when there is something to publish.

    Parameters
    ----------
    journal
        Read it directly; write through `write`.
    line
        The journal's own thread.
    committed
        Called on the event loop after each commit.
    """

    def __init__(self, journal: Journal, line: Line, committed: Callable[[], None] = lambda: None) -> None:
        self.journal = journal
        self.committed = committed
        self._line = line

    async def write(self, transition: Callable[Concatenate[Journal, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Carry out one of `labdaemon.journal.transitions`; it is on the disk when this returns."""
        result = await self._line.call(lambda: transition(self.journal, *args, **kwargs), WRITE_S)
        self.committed()
        return result

    def close(self) -> None:
        """End the thread; the journal itself is its owner's."""
        self._line.close()
