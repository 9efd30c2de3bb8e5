"""Documents of runs that are open, for dispatchers that come in the middle of one: without its start they show nothing.

bluesky publishes documents once, and who comes later waits for the next run. A campaign takes a night; so here a
newcomer gets the open runs from their start, once, and then what all get.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

MOST_BYTES = 64 << 20
"""Of all that is kept. Beyond that the oldest events are dropped, and never what a later one cannot be read without."""
DROPPABLE = frozenset({"event", "stream_datum"})


@dataclass(frozen=True, slots=True)
class KeptDocument:
    """A document as it was sent, and whose it is."""

    run: str
    name: str
    message: bytes


class OpenDocuments:
    """What was published of each run that has no stop yet.

    Parameters
    ----------
    most_bytes
        Of what is kept.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[int, KeptDocument] = OrderedDict()
        self._droppable: OrderedDict[int, None] = OrderedDict()
        self._run_of: dict[str, str] = {}
        """A descriptor's uid -> its run's."""
        self._count = self._bytes = 0

    def add(self, name: str, content: dict[str, Any], message: bytes) -> None:
        """Keep a document; a stop ends its run, and nothing of it is kept."""
        if name == "stop":
            self._forget(content["run_start"])
            return
        run = content["uid"] if name == "start" else content.get("run_start")
        if name == "descriptor":
            self._run_of[content["uid"]] = content["run_start"]
        run = run or self._run_of.get(content.get("descriptor", ""))
        if run is None:
            return
        self._count += 1
        self._kept[self._count] = KeptDocument(run, name, message)
        self._bytes += len(message)
        if name in DROPPABLE:
            self._droppable[self._count] = None
        while self._bytes > self._most_bytes and self._droppable:
            self._drop(next(iter(self._droppable)))

    def messages(self) -> Iterator[bytes]:
        """All that is kept, in the order in which it was sent."""
        return (document.message for document in self._kept.values())

    def _forget(self, run: str) -> None:
        for number in [number for number, document in self._kept.items() if document.run == run]:
            self._drop(number)
        self._run_of = {descriptor: other for descriptor, other in self._run_of.items() if other != run}

    def _drop(self, number: int) -> None:
        self._bytes -= len(self._kept.pop(number).message)
        self._droppable.pop(number, None)
