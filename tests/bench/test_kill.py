from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.bench.kill import KillOutcome, run_campaign, small_rig, table_of, without_gauges
from labdaemon.bench.verdict import CampaignVerdict


def test_gauges_are_left_out_and_nothing_else():
    toml = '[shaker]\nport = "a"\n[[gauge]]\nname = "table"\n[[gauge]]\nname = "response"\n[cameras.left]\nserial = "1"'
    assert without_gauges(toml) == '[shaker]\nport = "a"\n[cameras.left]\nserial = "1"'


def test_the_table_has_a_row_for_each_outcome():
    lines = table_of([KillOutcome("capture.fired", 3, [0.5, 1.5], CampaignVerdict(frames_lost=1))]).splitlines()
    assert len(lines) == 3
    assert lines[-1] == "| capture.fired | 3 | 1 | 0 | 0 | 0 | 0 | 0 | 1.50 s |"


@pytest.mark.slow
@pytest.mark.parametrize("transition", ["capture.fired", "before frame.stored"])
def test_killed_daemons_lose_nothing(tmp_path: Path, transition: str):
    with small_rig(5) as rig:
        outcome = run_campaign(rig, tmp_path, 1, transition=transition)
    assert outcome.kills == 2
    assert outcome.verdict.is_well, outcome.verdict
    assert len(outcome.rest_s) == 2
