from __future__ import annotations

import pytest

from labdaemon.guardian.silence_timer import LONGEST_TICK_S, ClockReading, SilenceTimer


def after(silence: SilenceTimer, *ticks: tuple[float, float]) -> float:
    """The silence after some ticks, each seconds of the machine running and seconds of it suspended."""
    at = silence._last
    for running_s, suspended_s in ticks:
        at = ClockReading(at.monotonic_s + running_s, at.boot_s + running_s + suspended_s)
        silence.tick(at)
    return silence.silent_s


def test_silence_is_the_time_since_the_last_heartbeat():
    silence = SilenceTimer(ClockReading(100.0, 500.0))
    assert after(silence, *[(0.1, 0.0)] * 12) == pytest.approx(1.2)
    silence.record_heartbeat(ClockReading(101.3, 501.3))
    assert silence.silent_s == 0.0
    assert silence.longest_s == pytest.approx(1.3)
    assert after(silence, (0.1, 0.0)) == pytest.approx(0.1)


def test_a_suspend_asks_once_more():
    silence = SilenceTimer(ClockReading(0.0, 0.0))
    assert after(silence, *[(0.1, 0.0)] * 15, (0.1, 3600.0)) == 0.0
    assert after(silence, *[(0.1, 0.0)] * 21) > 2.0
    assert silence.longest_s == 0.0


def test_time_in_which_the_guardian_itself_stood_still_hardly_counts():
    """A paused virtual machine, or a swap storm: the daemon could not beat, and the guardian could not hear."""
    silence = SilenceTimer(ClockReading(0.0, 0.0))
    assert after(silence, (2.0, 0.0)) == LONGEST_TICK_S
    assert after(silence, *[(2.0, 0.0)] * 4) > 2.0  # a hang is found all the same


def test_a_kernel_whose_monotonic_clock_runs_on_through_a_suspend():
    silence = SilenceTimer(ClockReading(0.0, 0.0))
    assert after(silence, *[(0.1, 0.0)] * 18, (3600.0, 0.0)) == 0.0
    assert after(silence, *[(0.1, 0.0)] * 21) > 2.0


def test_it_is_asked_once_more_only_once():
    """A machine that is suspended again and again, or hardly runs, must not keep a hung daemon alive."""
    silence = SilenceTimer(ClockReading(0.0, 0.0))
    assert after(silence, *[(1.0, 60.0), (9.0, 0.0)] * 3) > 2.0
    silence.record_heartbeat(ClockReading(100.0, 300.0))
    assert after(silence, (0.1, 60.0)) == 0.0


def test_a_gap_at_rest_does_not_count_as_the_longest():
    silence = SilenceTimer(ClockReading(0.0, 0.0))
    silence.record_heartbeat(ClockReading(8.0, 8.0), counts=False)
    silence.record_heartbeat(ClockReading(8.2, 8.2))
    assert silence.longest_s == pytest.approx(0.2)
