"""Campaigns under coded light, in simulated time: groups, retries of what was cut, and kill -9 at each transition."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labdaemon.capture.lamp import Lamp, LightRequest
from labdaemon.clock import SimulatedClock
from labdaemon.testing.lab import FakeLab
from labdaemon.testing.lamp import FakeLampTrigger
from labdaemon.tomlfile import read_toml

LAMP = Lamp(rise_s=1e-4, ambient=0.1, levels=256)
CAMPAIGN = """
name = "lit"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "steps"
frequency_hz = 5.0
amplitude_mm = 1.0
light = ["cos", "sin"]
[[phase]]
kind = "steps"
frequency_hz = 8.0
amplitude_mm = 1.0
light = "1110100"
"""


def captures(folder: Path) -> dict[str, dict[str, Any]]:
    return {path.parent.name: read_toml(path)[1] for path in sorted(folder.rglob("captures/*/capture.toml"))}


def lamp_of(lab: FakeLab) -> FakeLampTrigger:
    assert isinstance(lab.fake.trigger, FakeLampTrigger)
    return lab.fake.trigger


def test_a_pair_is_measured_jointly_and_its_light_is_in_folder_and_event(simulate: Callable[..., Any]) -> None:
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        record = await lab.until(id)
        assert record.state == "completed"
        lit = lamp_of(lab).lit
        assert lit[0] == 1.0  # the sharp frame
        assert [type(one) for one in lit[1:]] == [LightRequest] * 3
        events = lab.journal.events_after(0, 1000)
        assert [e.data["capture"] for e in events if e.kind == "envelope"] == [
            "00001-steps-5.000hz",
            "00002-steps-8.000hz-01",
        ]
        written = captures(lab.data)
        first, second, alone = written.values()
        assert first["group"] == second["group"] == "00001-steps-5.000hz"
        assert "group" not in alone
        assert len(first["light"]) == len(second["light"]) == 64
        assert first["light"] != second["light"]
        assert alone["light"] == [1, 1, 1, 0, 1, 0, 0]
        for name, about in written.items():
            [event] = [e for e in events if e.kind == "capture.completed" and e.data["capture"] == name]
            keys = ("light", "light_phase_rad", "light_cycles", "ambient", "light_rise_s")
            assert {key: event.data[key] for key in keys} == {key: about[key] for key in keys}
            assert about["light_cycles"] <= about["exposure_s"] * about["frequency_hz"]

    simulate(scenario, lamp=LAMP)


def test_what_was_cut_is_taken_again_under_another_name(simulate: Callable[..., Any]) -> None:
    async def scenario(lab: FakeLab) -> None:
        lamp_of(lab).cut = 1
        id = await lab.submit(CAMPAIGN)
        record = await lab.until(id)
        assert record.state == "completed"
        faults = [e.data for e in lab.journal.events_after(0, 1000) if e.kind == "fault"]
        assert [(fault["device"], fault["action"]) for fault in faults] == [("trigger", "retry")]
        assert list(captures(lab.data)) == [
            "00001-steps-5.000hz-01-r2",
            "00001-steps-5.000hz-02",
            "00002-steps-8.000hz-01",
        ]
        assert list((lab.data / "campaigns" / id / "set_aside").iterdir())

    simulate(scenario, lamp=LAMP)


def test_a_lamp_that_never_plays_pauses_the_campaign_at_rest(simulate: Callable[..., Any]) -> None:
    async def scenario(lab: FakeLab) -> None:
        lamp_of(lab).cut = 100
        record = await lab.until(await lab.submit(CAMPAIGN))
        assert record.state == "paused"
        assert "light code" in (record.reason or "")
        assert not lab.world.moves()
        assert captures(lab.data) == {}

    simulate(scenario, lamp=LAMP)


class Killed(BaseException):
    """What the engine dies of; nothing in it expects that."""


@pytest.mark.parametrize("transition", ["capture.fired", "capture.lit", "capture.exposed", "frame.stored"])
@pytest.mark.parametrize("when", ["before ", ""])
def test_killed_at(tmp_path: Path, transition: str, when: str) -> None:
    """Whatever is repeated or completed after a kill has the light that was played with it."""
    clock = SimulatedClock()

    async def main() -> None:
        lab = FakeLab(tmp_path, clock, lamp=LAMP)
        lab.start()
        id = await lab.submit(CAMPAIGN)
        killed = False

        def kill(name: str) -> None:
            nonlocal killed
            coded = lab.journal.read("SELECT count(*) FROM captures WHERE step > 0")[0][0]
            if name == when + transition and coded and not killed:
                killed = True
                raise Killed

        lab.journal.listen(kill)
        try:
            await lab.until(id, "completed")
        except Killed:
            await lab.kill()
            lab.start()
            await lab.until(id, "completed")
        assert killed
        written = captures(tmp_path)
        assert len(written) == 3
        assert [len(about["light"]) for about in written.values()] == [64, 64, 7]
        assert all(about["light_cycles"] >= 1 and about["ambient"] == 0.1 for about in written.values())
        await lab.kill()

    clock.run(main())
