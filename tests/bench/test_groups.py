"""The bench of phased groups: true ones agree, two motions in one group are seen, and shares have their interval."""

import pytest

from labdaemon.bench.groups import GroupTrials, group_windows, run_groups


@pytest.mark.parametrize("kind", ["two openings, 5.5 cycles", "code 1110100 twice"])
def test_a_capture_of_another_amplitude_is_seen_and_one_of_the_same_is_not(kind: str) -> None:
    windows = group_windows()[kind]
    assert run_groups(windows, 0.8, 2, seed=3).contradictions == 0
    assert run_groups(windows, 0.8, 1, change=0.1, seed=3).contradictions == 1


@pytest.mark.parametrize(("count", "seen", "upper"), [(100, 0, 0.0362), (500, 5, 0.0232), (4, 4, 1.0)])
def test_a_share_has_its_upper_bound(count: int, seen: int, upper: float) -> None:
    assert GroupTrials(count, seen, 0).upper == pytest.approx(upper, abs=2e-4)
