"""How long events are kept. History is cut from its beginning, so what is left has no gap.

Never cut are the last events (`LEAST_LEFT`), and all from the first event of a campaign that has not ended. Age is
counted back from the newest event and not from the clock, which may be wrong for a while.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from labdaemon.clock import rfc3339
from labdaemon.journal.journal import Journal

LEAST_LEFT = 1000
AT_A_TIME = 2000
"""Events removed in one transaction: some ten milliseconds, in which nothing else is written."""


@dataclass(frozen=True, slots=True)
class Retention:
    """What is kept; None for everything.

    Attributes
    ----------
    days
        Age of the oldest event, days.
    events
        Number of events.
    """

    days: float | None = None
    events: int | None = None

    @property
    def is_unlimited(self) -> bool:
        """Whether nothing is ever cut."""
        return self.days is None and self.events is None


def first_to_keep(journal: Journal, retention: Retention) -> int:
    """`seq` of the first event that must stay."""
    last = journal.last_seq
    first = 1
    if retention.events is not None:
        first = last - retention.events + 1
    if retention.days is not None and (newest := _at(journal, last)) is not None:
        oldest = datetime.fromisoformat(newest) - timedelta(days=retention.days)
        first = max(first, _first_since(journal, rfc3339(oldest)))
    unfinished = journal.read(
        "SELECT min(seq) FROM events WHERE campaign IN "
        "(SELECT id FROM campaigns WHERE state IN ('queued', 'running', 'paused'))"
    )[0][0]
    limits = [first, last - LEAST_LEFT + 1] + ([unfinished] if unfinished is not None else [])
    return int(max(min(limits), 1))


def cut_history(journal: Journal, before: int) -> bool:
    """Remove some of the events before a `seq`; False when none is left."""
    with journal.transaction("history.cut") as write:
        removed = write.execute(
            "DELETE FROM events WHERE seq IN (SELECT seq FROM events WHERE seq < ? ORDER BY seq LIMIT ?)",
            before,
            AT_A_TIME,
        ).rowcount
    return removed == AT_A_TIME


def _at(journal: Journal, seq: int) -> str | None:
    """When the first event from this `seq` on was made."""
    rows = journal.read("SELECT at FROM events WHERE seq >= ? ORDER BY seq LIMIT 1", seq)
    return str(rows[0][0]) if rows else None


def _first_since(journal: Journal, at: str) -> int:
    """`seq` of the first event that is not older; found by halves, since times rise with `seq`."""
    least, most = 1, journal.last_seq + 1
    while least < most:
        middle = (least + most) // 2
        seen = _at(journal, middle)
        if seen is None or seen >= at:
            most = middle
        else:
            least = middle + 1
    return least
