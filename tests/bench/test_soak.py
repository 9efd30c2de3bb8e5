from __future__ import annotations

import logging
from pathlib import Path

import pytest

from labdaemon.bench.soak import campaign, soak, table_of
from labdaemon.campaign.campaign_file import load_campaign


@pytest.mark.slow
def test_hours_of_faults_lose_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.CRITICAL, logger="labdaemon"):
        soaked = soak(tmp_path, captures=100, hours=1.0, faults=30, restarts=2)
    assert soaked.captures >= 100
    assert soaked.faults >= 15
    assert soaked.restarts >= 1
    assert soaked.verdict.is_well, soaked.verdict
    assert soaked.descriptors[0] == soaked.descriptors[1]
    assert "| frames lost | 0 |" in table_of(soaked)


def test_its_campaign_is_as_long_as_it_is_asked_for():
    phases = load_campaign(campaign(10_000, 72.0)).section.phase
    assert len(phases) == 7
