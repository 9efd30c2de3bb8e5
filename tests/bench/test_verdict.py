from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from labdaemon.bench.verdict import CampaignVerdict, judge
from labdaemon.clock import SimulatedClock
from labdaemon.journal import transitions
from labdaemon.testing.lab import FakeLab

CAMPAIGN = """
name = "judged"
[[phase]]
kind = "steps"
frequency_hz = [5.0, 7.0]
amplitude_mm = 1.0
exposure_s = 1.0
"""


@pytest.fixture
def judged(tmp_path: Path):
    """Run a campaign, do something to its folder, and judge it."""

    def run(damage) -> CampaignVerdict:
        clock = SimulatedClock()

        async def main() -> int:
            lab = FakeLab(tmp_path, clock)
            lab.start()
            id = await lab.submit(CAMPAIGN)
            await lab.until(id, "completed")
            damage(lab, id)
            await lab.kill()
            return sum(len(camera.made) for camera in lab.fake.cameras)

        return judge(tmp_path, taken=clock.run(main()), on_cards=0, captures=2, has_files=False)

    return run


def test_a_good_folder_is_well(judged):
    assert judged(lambda lab, id: None) == CampaignVerdict()
    assert CampaignVerdict().is_well


def test_every_kind_of_damage_is_seen(judged):
    def damage(lab: FakeLab, id: str) -> None:
        [frame] = lab.data.rglob("00001*/left.dng")
        frame.write_bytes(hashlib.sha256(b"another").digest())
        (lab.data / "x.part").touch()
        with lab.journal.transaction("test") as write:
            write.emit("envelope", id, {"step": 1})
            write.last_seq += 1
            write.emit("fault", None, {})
        transitions.submit(lab.journal, "never run", "", "")

    found = judged(damage)
    assert (found.frames_lost, found.results_repeated, found.stray_parts, found.seq_gaps) == (1, 1, 1, 1)
    assert found.open_ends >= 1
    assert not found.is_well
