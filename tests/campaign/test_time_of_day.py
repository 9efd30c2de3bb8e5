from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.time_of_day import wait_s

times = st.builds("{:02d}:{:02d}".format, st.integers(0, 23), st.integers(0, 59))


def at(hour: int, minute: int = 0) -> datetime:
    return datetime(2026, 5, 4, hour, minute, tzinfo=UTC)


@pytest.mark.parametrize(
    ("now", "before", "after", "expected_h"),
    [
        (at(12), None, None, 0),
        (at(12), "14:00", "16:00", 2),
        (at(15), "14:00", "16:00", 0),
        (at(16), "14:00", "16:00", 22),
        (at(23), "22:00", "06:00", 0),
        (at(3), "22:00", "06:00", 0),
        (at(12), "22:00", "06:00", 10),
        (at(20), "18:00", None, 0),
        (at(20), None, "18:00", 4),
    ],
)
def test_windows(now: datetime, before: str | None, after: str | None, expected_h: float):
    assert wait_s(now, before, after) == expected_h * 3600.0


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 86399), times, times)
def test_after_the_wait_the_window_is_open(second: int, before: str, after: str):
    now = at(0) + timedelta(seconds=second)
    wait = wait_s(now, before, after)
    assert 0.0 <= wait <= 86400.0
    if before != after:
        assert wait_s(now + timedelta(seconds=wait), before, after) == 0.0
