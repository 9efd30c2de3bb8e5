"""The engine is dropped at every journalled transition, before and after its commit, in simulated time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from labdaemon.bench.kill import ONCE, TRANSITIONS
from labdaemon.clock import SimulatedClock
from labdaemon.journal import records
from labdaemon.journal.frames import PART
from labdaemon.journal.gauge_records import gauges_in
from labdaemon.journal.gauge_table import gauges_text
from labdaemon.testing.lab import FakeLab

CAMPAIGN = """
name = "killed"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "steps"
frequency_hz = { start = 5, stop = 9, count = 4 }
amplitude_mm = 1.0
exposure_s = 1.0
"""


class Killed(BaseException):
    """What the engine dies of; nothing in it expects that."""


def kill_once_a_step(lab: FakeLab, transition: str, done: set[int]) -> Callable[[str], None]:
    def listen(name: str) -> None:
        step = lab.journal.read("SELECT coalesce(max(step), -1) FROM steps")[0][0]
        if name == transition and step not in done:
            done.add(step)
            raise Killed

    return listen


@pytest.mark.parametrize("transition", [*ONCE[1:], *TRANSITIONS])
@pytest.mark.parametrize("when", ["before ", ""])
def test_killed_at(tmp_path: Path, transition: str, when: str):
    clock = SimulatedClock()

    async def main() -> int:
        lab = FakeLab(tmp_path, clock)
        lab.start()
        id = await lab.submit(CAMPAIGN)
        done: set[int] = set()
        kills = 0
        lab.journal.listen(kill_once_a_step(lab, when + transition, done))
        while True:
            try:
                record = await lab.until(id, "completed")
                break
            except Killed:
                kills += 1
                await lab.kill()
                lab.start()
                lab.journal.listen(kill_once_a_step(lab, when + transition, done))
        assert record.state == "completed"
        events = lab.journal.events_after(0, 10_000)
        assert [event.seq for event in events] == list(range(1, len(events) + 1))
        envelopes = [event.data["step"] for event in events if event.kind == "envelope"]
        assert sorted(envelopes) == [1, 2, 3, 4]
        in_file = lab.measurer.results[tmp_path / "campaigns" / id]
        assert len(in_file) == len(set(in_file)) == 4
        made = {digest for camera in lab.fake.cameras for digest in camera.made}
        kept = {hashlib.sha256(path.read_bytes()).hexdigest() for path in tmp_path.rglob("*.[dD][nN][gG]")}
        assert made == kept
        assert not list(tmp_path.rglob(f"*{PART}"))
        assert not any(camera.card for camera in lab.fake.cameras)
        assert records.captures(lab.journal, None, "intended", "fired", "exposed") == []
        assert not lab.world.running
        # Every capture that counts has its gauges, in the journal, its capture.toml and gauges.csv, once.
        seen = gauges_in(lab.journal, id)
        assert [one.gauge for _, one in seen] == ["response", "table"] * 4
        table = (tmp_path / "campaigns" / id / "results" / "gauges.csv").read_text()
        assert table == gauges_text(seen)
        for capture, one in seen:
            about = (tmp_path / "campaigns" / id / "captures" / capture / "capture.toml").read_text()
            assert f"[gauges.{one.gauge}]" in about
        await lab.kill()
        return kills

    assert clock.run(main()) >= 1
