from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.bench.faults import WELL, Met, Patient, table_of
from labdaemon.bench.kill import small_rig


def test_the_table_counts_endings_a_device():
    met = [
        Met("shaker", "silent", True, "stopped, then went on", "no answer", 3.0),
        Met("shaker", "late", True, "HANGS", None, 180.0),
        Met("left", "busy", True, "went on", None, 1.0),
    ]
    lines = table_of(met).splitlines()
    assert lines[2:] == ["| shaker | 2 × 1 | 0 | 1 | 1 | 180 s |", "| left | 1 × 1 | 1 | 0 | 0 | 1 s |"]


@pytest.mark.slow
@pytest.mark.parametrize(("device", "fault"), [("shaker", "hang_up"), ("trigger", "enable_drops")])
def test_a_lasting_fault_is_told_survived_and_leaves_the_table_at_rest(tmp_path: Path, device: str, fault: str):
    with small_rig(4) as rig:
        patient = Patient(rig, tmp_path)
        try:
            met = patient.meet(device, fault, lasting=True)
        finally:
            patient.close()
    assert met.ending in WELL
    assert met.told is not None
