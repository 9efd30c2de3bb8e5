"""How long the engine waits between attempts."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.retry import MAX_BACKOFF_S, RetryPolicy


def test_waits_double_up_to_a_minute() -> None:
    policy = RetryPolicy(backoff_s=2.0)
    assert [policy.pause_s(failures) for failures in range(1, 8)] == [2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(failures=st.integers(1, 500), backoff_s=st.floats(0.0, 100.0))
def test_no_wait_is_negative_or_endless(failures: int, backoff_s: float) -> None:
    """A night of failures must not overflow, nor wait for hours."""
    assert 0.0 <= RetryPolicy(backoff_s=backoff_s).pause_s(failures) <= MAX_BACKOFF_S
