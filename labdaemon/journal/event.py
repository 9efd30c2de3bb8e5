"""An event as it is kept and sent: the journal's record of something that subscribers receive."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Event:
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
