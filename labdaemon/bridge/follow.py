"""A daemon's events for a bridge: in order, through restarts of the daemon, from the place where the bridge was."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from labdaemon.stream.client import Client, EventStream, HistoryCut, JournalChanged, NoDaemon

SILENT_S = 3.5
"""A daemon whose heartbeat has been missing for so long is reported as silent."""
SLICE_S = 0.5


@dataclass(frozen=True, slots=True)
class Place:
    """What a bridge has passed on already.

    Attributes
    ----------
    seq
        Of the last event.
    journal
        UUID of its history; None where it is not known.
    """

    seq: int
    journal: str | None = None


def follow_events(client: Client, place: Place | None) -> Generator[dict[str, Any] | None]:
    """Events after a place (from now on without one), statuses among them; None as long as the daemon is silent.

    Where the daemon has begun another journal, that one follows from its beginning.
    """
    heard_s = time.monotonic()
    after, journal = (place.seq, place.journal) if place is not None else (None, None)
    with closing(EventStream(client, after=after, journal=journal)) as stream:
        while True:
            try:
                event = stream.receive(SLICE_S)
            except (JournalChanged, HistoryCut, NoDaemon):
                continue  # the new history begins with the next call; a gap is asked for again
            if event is not None:
                heard_s = time.monotonic()
                yield event
            elif time.monotonic() > heard_s + SILENT_S:
                yield None


def open_campaign_place(client: Client) -> Place | None:
    """Just before the campaign that runs now; None where none does."""
    latest = client.latest()
    started = latest.get("campaign.started")
    if started is None:
        return None
    ends = [latest[kind] for kind in ("campaign.completed", "campaign.aborted", "campaign.failed") if kind in latest]
    if any(end["campaign"] == started["campaign"] and end["seq"] > started["seq"] for end in ends):
        return None
    return Place(started["seq"] - 1, started["journal"])
