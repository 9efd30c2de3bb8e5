"""An event as it is kept and sent: the journal's record of something that subscribers receive."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """One line of a journal's history.

    Attributes
    ----------
    seq
        Rises by exactly one for each event over a journal's whole life, restarts included.
    at
        RFC 3339 UTC.
    kind
        Topic, as ``capture.completed``.
    campaign
        The campaign's id, None for events outside any.
    data
        JSON-able payload.
    journal
        UUID of the journal, so that a client knows when it meets another history.
    """

    seq: int
    at: str
    kind: str
    campaign: str | None
    data: dict[str, Any]
    journal: str

    def as_dict(self) -> dict[str, Any]:
        """The event as messages carry it, version included."""
        return {
            "v": 1,
            "seq": self.seq,
            "at": self.at,
            "kind": self.kind,
            "campaign": self.campaign,
            "journal": self.journal,
            "data": self.data,
        }

    def to_json(self) -> bytes:
        """UTF-8 JSON; refuses NaN, which JSON does not know."""
        return json.dumps(self.as_dict(), allow_nan=False, separators=(",", ":")).encode()

    def text(self) -> EventText:
        """The event as `EventText`."""
        return EventText(self.seq, self.kind, self.to_json())


@dataclass(frozen=True, slots=True)
class EventText:
    """An event as it travels, with what is needed to send it.

    Its payload is never parsed on its way from the journal to a client: an envelope of many targets would take the
    event loop milliseconds each.

    Attributes
    ----------
    seq, kind
        As in `StoredEvent`.
    json
        The whole event as UTF-8 JSON.
    """

    seq: int
    kind: str
    json: bytes


def event_text(row: tuple[int, str, str, str | None, str], journal: str) -> EventText:
    """An event from its row: ``seq``, ``at``, ``kind``, ``campaign`` and ``data`` (JSON already)."""
    seq, at, kind, campaign, data = row
    head = json.dumps({"v": 1, "seq": seq, "at": at, "kind": kind, "campaign": campaign, "journal": journal})
    return EventText(seq, kind, f'{head[:-1]}, "data": {data}}}'.encode())


def limit_bytes(texts: Iterable[EventText], most_bytes: int) -> list[EventText]:
    """The first of them that are together not larger than this, but at least one; reads no further than needed."""
    taken: list[EventText] = []
    size = 0
    for text in texts:
        size += len(text.json)
        if taken and size > most_bytes:
            break
        taken.append(text)
    return taken
