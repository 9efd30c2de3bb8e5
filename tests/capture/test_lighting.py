"""Light of a capture on a rig in memory: what is played, what journal and capture.toml say of it, and what fails."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture.acquisition import acquire
from labdaemon.capture.collect import FETCH_TRIES
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.lamp import Lamp, LightRequest, plays_light
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.recover import recover
from labdaemon.capture.request import CaptureRequest
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, DeviceRefused
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.light_record import LightRecord, light_of
from labdaemon.journal.records import NO_STEP, CaptureRecord
from labdaemon.testing.lamp import FakeLampTrigger, give_lamp
from labdaemon.testing.rig import fake_rig
from labdaemon.tomlfile import read_toml

SEVEN = (1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0)
LAMP = Lamp(rise_s=1e-4, ambient=0.1)
ASKED = LightRequest(SEVEN, 4, 0.5)


class Follower:
    """Follows a capture and asks for nothing."""

    def capture_started(self) -> None:
        pass

    def capture_fired(self, capture: CaptureRecord) -> None:
        pass

    async def describe(self, capture: CaptureRecord) -> CaptureRecord:
        return capture

    async def capture_stored(self, capture: CaptureRecord) -> None:
        pass

    def capture_ended(self) -> None:
        pass


Scenario = Callable[[AcquisitionContext, FakeLampTrigger, CaptureRequest], Awaitable[None]]


def run(folder: Path, scenario: Scenario, lamp: Lamp | None = LAMP) -> None:
    clock = SimulatedClock()
    fake = fake_rig(clock)
    fake.world.line_wired = False  # no heartbeats here
    trigger = give_lamp(fake)
    journal = Journal(folder, clock, synchronous="OFF")

    async def main() -> None:
        recorder = Recorder(journal, InlineExecutor("journal", lambda: 0.0))
        campaign = await recorder.write(transitions.open_manual)
        context = AcquisitionContext(fake.rig, Table(fake.rig, clock, None), recorder, clock, folder, lamp=lamp)
        cameras = tuple(fake.rig.cameras)
        request = CaptureRequest(
            campaign, "one", NO_STEP, 0, "one", False, None, None, 5.0, 2.0, 1.0, cameras, Excitation(5.0, 2.0)
        )
        await scenario(context, trigger, request)

    clock.run(main())
    journal.close()


def test_a_code_is_played_recorded_and_written(tmp_path: Path) -> None:
    async def scenario(context: AcquisitionContext, trigger: FakeLampTrigger, request: CaptureRequest) -> None:
        await acquire(context, replace(request, light=ASKED), Follower())
        assert trigger.lit == [ASKED]
        known = light_of(context.recorder.journal, request.campaign, "one")
        assert known == LightRecord(SEVEN, 4, 0.5, 2e-4, 0.1, 1e-4)
        _, written = read_toml(tmp_path / "campaigns/0000-manual/captures/one/capture.toml")
        expected = {"light": list(SEVEN), "light_phase_rad": 0.5, "light_cycles": 4, "ambient": 0.1}
        assert {key: written[key] for key in expected} == expected
        assert written["light_rise_s"] == 1e-4
        assert written["sd_light_phase_rad"] == 2e-4
        assert "sd_ambient" not in written  # the rig file does not say it
        assert written["phase_rad"] == 0.25  # the opening, too
        [event] = [one for one in context.recorder.journal.events_after(0, 100) if one.kind == "capture.completed"]
        assert event.data["light"] == list(SEVEN)
        assert event.data["light_cycles"] == 4

    run(tmp_path, scenario)


def test_other_captures_have_the_lamp_on_each_time(tmp_path: Path) -> None:
    async def scenario(context: AcquisitionContext, trigger: FakeLampTrigger, request: CaptureRequest) -> None:
        for name in ("one", "two"):
            await acquire(context, replace(request, name=name), Follower())
        assert trigger.lit == [1.0, 1.0]
        assert light_of(context.recorder.journal, request.campaign, "one") is None
        _, written = read_toml(tmp_path / "campaigns/0000-manual/captures/one/capture.toml")
        assert not {"light", "ambient", "light_cycles"} & set(written)

    run(tmp_path, scenario)


def test_a_code_that_was_cut_is_no_capture_and_its_frames_are_set_aside(tmp_path: Path) -> None:
    async def scenario(context: AcquisitionContext, trigger: FakeLampTrigger, request: CaptureRequest) -> None:
        trigger.cut = 1
        coded = replace(request, light=ASKED)
        with pytest.raises(DeviceError, match="played 1 of 4"):
            await acquire(context, coded, Follower())
        await recover(context)
        [capture] = records.captures(context.recorder.journal, None)
        assert capture.state == "discarded"
        assert list((tmp_path / "campaigns/0000-manual/set_aside").rglob("*.*"))
        await acquire(context, replace(coded, name="two"), Follower())
        assert light_of(context.recorder.journal, request.campaign, "two") is not None

    run(tmp_path, scenario)


def test_killed_after_the_exposure_the_capture_is_completed_with_its_light(tmp_path: Path) -> None:
    """What `recover` writes is what an uninterrupted capture writes."""

    async def scenario(context: AcquisitionContext, trigger: FakeLampTrigger, request: CaptureRequest) -> None:
        trigger.world.fail("left.download", *["gone"] * FETCH_TRIES)
        with pytest.raises(DeviceError, match="port is gone"):
            await acquire(context, replace(request, light=ASKED), Follower())
        [capture] = records.captures(context.recorder.journal, None)
        assert capture.state == "exposed"
        path = tmp_path / "campaigns/0000-manual/captures/one/capture.toml"
        assert not path.exists()
        await recover(context)
        assert read_toml(path)[1]["light"] == list(SEVEN)
        assert read_toml(path)[1]["light_phase_rad"] == 0.5

    run(tmp_path, scenario)


@pytest.mark.parametrize("lamp", [None, LAMP])
def test_a_code_without_lamp_or_player_is_refused(tmp_path: Path, lamp: Lamp | None) -> None:
    async def scenario(context: AcquisitionContext, trigger: FakeLampTrigger, request: CaptureRequest) -> None:
        if lamp is not None:
            type(trigger).plays_light = False
        try:
            with pytest.raises(DeviceRefused, match=r"no \[lamp\]|no lamp output"):
                await acquire(context, replace(request, light=ASKED), Follower())
        finally:
            type(trigger).plays_light = True
        assert plays_light(trigger)
        assert trigger.world.fired == 0

    run(tmp_path, scenario, lamp)


@settings(deadline=None)
@given(st.floats(0.1, 30.0), st.floats(1.0, 50.0), st.integers(2, 64))
def test_cycles_fit_into_the_open_shutter_with_a_sector_to_wait_for(exposure_s: float, f_hz: float, n: int) -> None:
    cycles = LAMP.cycles_within(exposure_s, f_hz, n)
    assert cycles >= 0
    assert cycles == 0 or (cycles + 1 / n) / f_hz <= exposure_s - LAMP.margin_s + 1e-6
    assert (cycles + 1 + 1 / n) / f_hz > exposure_s - LAMP.margin_s - 1e-6


def test_a_lamp_shows_what_its_levels_allow() -> None:
    assert Lamp(levels=2).shown((0.2, 0.7)) == (0.0, 1.0)
    assert Lamp(levels=3).shown((0.2, 0.7)) == (0.0, 0.5)
