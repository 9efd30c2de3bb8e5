from __future__ import annotations

from statistics import median

import pytest

from labdaemon.bench.interlock import RecordingProxy, StopLatencies, run


@pytest.mark.parametrize(
    ("passed", "at"),
    [
        ([(1.0, b"OUTP OFF\n")], 1.0),
        ([(0.5, b"VOLT 2.0\n"), (1.2, b"VOLT 2.5\n"), (1.4, b"VOLT 2.1\n")], 1.4),
        ([(0.5, b"VOLT 2.0\n"), (1.1, b"OUTP?\n")], None),
        ([(0.5, b"OUTP OFF\n")], None),
    ],
)
def test_only_what_brings_the_table_down_counts(passed: list[tuple[float, bytes]], at: float | None):
    assert RecordingProxy("localhost", 1, passed).first_stop_after(1.0) == at


def test_the_percentile_is_of_all():
    assert StopLatencies((0.01,) * 99, (0.5,)).p99_s == 0.5


@pytest.mark.slow
def test_a_trip_reaches_the_wire_within_a_tenth_of_a_second():
    """The bench states the 99th percentile; a busy machine may delay one of a few, not half of them."""
    found = run(6, seed=2)
    assert median(found.settled_s + found.ramping_s) <= 0.1
    assert len(found.settled_s) == len(found.ramping_s) == 3
