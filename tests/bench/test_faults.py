from __future__ import annotations

from collections.abc import Iterator

import pytest

from labdaemon.bench.faults import WELL, FaultOutcome, FaultTrial, table_of
from labdaemon.bench.kill import small_rig


def test_the_table_counts_endings_a_device():
    outcomes = [
        FaultOutcome("shaker", "silent", True, "stopped, then went on", "no answer", 3.0),
        FaultOutcome("shaker", "late", True, "HANGS", None, 180.0),
        FaultOutcome("left", "busy", True, "went on", None, 1.0),
    ]
    lines = table_of(outcomes).splitlines()
    assert lines[2:] == ["| shaker | 2 × 1 | 0 | 1 | 1 | 180 s |", "| left | 1 × 1 | 1 | 0 | 0 | 1 s |"]


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FaultTrial]:
    """A daemon and its simulated rig, for one fault after the other, as the bench uses them."""
    with small_rig(4) as rig:
        trial = FaultTrial(rig, tmp_path_factory.mktemp("faults"))
        yield trial
        trial.close()


@pytest.mark.slow
@pytest.mark.parametrize(("device", "fault"), [("shaker", "hang_up"), ("trigger", "enable_drops")])
def test_a_lasting_fault_is_told_survived_and_leaves_the_table_at_rest(trial: FaultTrial, device: str, fault: str):
    outcome = trial.run_fault(device, fault, lasting=True)
    assert outcome.ending in WELL
    assert outcome.message is not None
