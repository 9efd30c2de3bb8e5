"""Frames and openings, through the engine in simulated time: late files, kills, and bodies without a useful clock."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.journal import card_records, records
from labdaemon.testing.lab import FakeLab

STEPS = """
name = "late"
[[phase]]
kind = "sharp"
frames = 2
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0]
amplitude_mm = [2.0, 1.0]
exposure_s = 2.0
on_fault = "retry"
"""
BODIES = {
    "as usual": {},
    "without a date": {"has_date": False},
    "with a clock that stands": {"has_clock": False},
    "that gives all files one name": {"has_date": False, "one_name": True},
}


@pytest.fixture
def simulate(tmp_path: Path) -> Callable[..., Any]:
    def run(scenario: Callable[[FakeLab], Coroutine[Any, Any, Any]]) -> Any:
        clock = SimulatedClock()

        async def main() -> Any:
            lab = FakeLab(tmp_path / "data", clock)
            lab.start()
            try:
                return await scenario(lab)
            finally:
                await lab.kill()

        return clock.run(main())

    return run


def check_frames(lab: FakeLab) -> None:
    """Every stored frame was exposed at its capture's opening, and each shot is on disk once, or on its card."""
    began_s = lab.clock.now().timestamp() - lab.clock.monotonic()
    for capture in records.captures(lab.journal, None, "stored", "measured", "unmeasured"):
        for frame in records.frames(lab.journal, capture.campaign, capture.name):
            exposed_s = float((lab.data / frame.path).read_text().split()[-1])
            opened_s = datetime.fromisoformat(capture.opened_at or "").timestamp() - began_s
            assert abs(exposed_s - opened_s) < 0.5, f"{capture.name}/{frame.camera} is of another opening"
    made = sorted(digest for camera in lab.fake.cameras for digest in camera.made)
    files = [path.read_bytes() for path in lab.data.rglob("*") if path.suffix.lower() == ".dng"]
    files += [content for camera in lab.fake.cameras for _, content in camera.card.values()]
    assert sorted(hashlib.sha256(content).hexdigest() for content in files) == made


async def open_shutters(lab: FakeLab, campaign: str) -> None:
    """Wait until a blurred capture was fired."""
    while not [one for one in records.captures(lab.journal, campaign, "fired") if not one.is_sharp]:
        await lab.clock.sleep(0.05)


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("late_s", [0.0, 9.0, 45.0])
def test_a_file_that_comes_after_a_kill_is_no_later_capture_s(simulate, body: str, late_s: float):
    async def scenario(lab: FakeLab) -> None:
        left = lab.fake.cameras[0]
        for name, value in BODIES[body].items():
            setattr(left, name, value)
        id = await lab.submit(STEPS)
        await open_shutters(lab, id)
        await asyncio.sleep(0.5)
        left.arriving = type(left.arriving)((handle, at_s + late_s) for handle, at_s in left.arriving)
        await lab.kill()
        lab.start()
        assert (await lab.until(id)).state == "completed"
        await lab.clock.sleep(60.0)
        check_frames(lab)
        assert not card_records.owed_files(lab.journal, "left") or late_s > 30.0

    simulate(scenario)


@pytest.mark.parametrize("body", BODIES)
def test_a_body_that_is_always_late_is_never_mispaired(simulate, body: str):
    """Each file comes after the next release would be due: its captures are refused, not guessed."""

    async def scenario(lab: FakeLab) -> None:
        left = lab.fake.cameras[0]
        for name, value in BODIES[body].items():
            setattr(left, name, value)
        id = await lab.submit(STEPS)
        await open_shutters(lab, id)
        left.late_s = 40.0
        await lab.until(id)
        left.late_s = 0.0
        await lab.clock.sleep(100.0)
        check_frames(lab)
        await lab.engine.resume()
        assert (await lab.until(id)).state == "completed"
        check_frames(lab)

    simulate(scenario)


@pytest.mark.parametrize("body", BODIES)
def test_a_night_with_such_a_body_ends_well(simulate, body: str):
    async def scenario(lab: FakeLab) -> None:
        for camera in lab.fake.cameras:
            for name, value in BODIES[body].items():
                setattr(camera, name, value)
        id = await lab.submit(STEPS)
        assert (await lab.until(id)).state == "completed"
        refused = len(records.captures(lab.journal, id, "discarded"))
        assert refused <= (2 if body == "with a clock that stands" else 0)  # one a camera, to find it out
        assert not any(camera.card for camera in lab.fake.cameras)
        assert card_records.card_files(lab.journal, "left") == {}
        check_frames(lab)

    simulate(scenario)


def test_the_clocks_are_in_the_journal(simulate):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(STEPS)
        await lab.until(id)
        offsets = card_records.clock_offsets(lab.journal)
        assert set(offsets) == {"left", "right"}
        assert 0.0 < offsets["left"].sd_s < 1.0
        known_s = lab.engine.context.clocks.offset_s("left")
        await lab.kill()
        lab.start()
        assert lab.engine.context.clocks.offset_s("left") == pytest.approx(known_s, abs=1e-3)

    simulate(scenario)


@pytest.mark.parametrize("gap_s", [8.0, 20.0, 60.0])
def test_a_body_that_missed_an_outside_release_is_not_lent_the_next_one_s_file(simulate, gap_s: float):
    toml = """
name = "outside"
[[phase]]
kind = "external"
exposure_s = 1.0
frequency_hz = 7.0
captures = 4
wait_s = 600
on_fault = "retry"
"""

    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(toml)
        while lab.engine.step is None:
            assert lab.clock.monotonic() < 600.0, "the engine has ended"
            await lab.clock.sleep(1.0)
        for turn in range(8):
            await lab.clock.sleep(gap_s)
            if turn == 2:
                lab.world.fail("right.release", "lost_file")
            lab.fake.trigger.edge(1.0)
        await lab.until(id)
        kept = records.captures(lab.journal, id, "stored", "measured", "unmeasured")
        assert len(kept) >= 2
        check_frames(lab)

    simulate(scenario)
