"""Hours of the day in which a step may start, by the computer's local time."""

from __future__ import annotations

from datetime import datetime, timedelta

POLL_S = 60.0
"""Longest wait between two looks at the wall clock, which a person or a time server may set meanwhile."""


def wait_s(now: datetime, not_before: str | None, not_after: str | None) -> float:
    """Seconds until a window opens, 0 inside it.

    Parameters
    ----------
    now
        Local time, aware.
    not_before, not_after
        ``HH:MM``; a window may span midnight. None leaves that side open (from 00:00, until 24:00).
    """
    if not_before is None and not_after is None:
        return 0.0
    opens = _minutes(not_before) if not_before else 0
    closes = _minutes(not_after) if not_after else 24 * 60
    minute = now.hour * 60 + now.minute
    inside = opens <= minute < closes if opens < closes else minute >= opens or minute < closes
    if inside:
        return 0.0
    start = now.replace(hour=opens // 60, minute=opens % 60, second=0, microsecond=0)
    if start <= now:
        start += timedelta(days=1)
    return (start - now).total_seconds()


def _minutes(text: str) -> int:
    hours, minutes = text.split(":")
    return int(hours) * 60 + int(minutes)
