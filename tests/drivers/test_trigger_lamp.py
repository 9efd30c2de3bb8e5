"""The trigger box's lamp output: driver against simulator over the real wire, and what the lamp then truly did."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture.lamp import LightRequest, plays_light
from labdaemon.errors import DeviceError, DeviceRefused, UsageError
from labdrivers.ptp.codes import Prop
from labdrivers.rts_trigger import RtsTrigger
from labdrivers.sim.assembly import SimulatedRig, set_default_rig
from labdrivers.sim.lamp_output import ArmedCode, LampOutput
from labdrivers.sim.rig import ExposureJob
from labdrivers.sim.wire import PtyPort
from labdrivers.trigger_box import TriggerBox

SEVEN = (1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0)
EXPOSURE_S = 0.5


@pytest.fixture
def slow(rig: SimulatedRig) -> SimulatedRig:
    """The rig with its cameras at half a second."""
    for camera in rig.bus.cameras.values():
        camera.body.settings.set(Prop.EXPOSURE_TIME, 5000)
    return rig


def fire(trigger: TriggerBox, code: tuple[float, ...] = SEVEN, cycles: int = 4, phase_rad: float = 0.0):
    firing = trigger.fire_coded(EXPOSURE_S, LightRequest(code, cycles, phase_rad), frequency_hz=12.0)
    return firing, trigger.read_played(30.0)


def test_a_code_follows_the_excitation_inside_the_open_shutters(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    firing, played = fire(trigger, phase_rad=1.0)
    assert set(firing.opening_s) == {"left", "right"}
    assert played.brightness == SEVEN
    assert played.cycles == 4
    assert played.period_s == pytest.approx(1 / 12.0, rel=1e-4)
    assert abs(played.phase_rad - 1.0) < 1e-4
    assert 0 < played.sd_phase_rad < 1e-3
    # What the lamp truly did, against the excitation's true phase.
    lamp, rig = slow.rig._lamp, slow.rig
    times, levels = np.array(lamp.times_s), np.array(lamp.levels)
    dark = int(np.flatnonzero(levels == 0.0)[0])
    first = dark + 1
    edges = times[first : first + 4 * 4]
    phases = np.array([rig.excitation_phase(t) for t in edges]) - played.phase_rad
    sectors = phases / (2 * np.pi) * 7
    assert np.abs(sectors - np.round(sectors)).max() < 2e-3
    for time_s, level in zip(times[first:], levels[first:], strict=True):
        sector = round((rig.excitation_phase(time_s) - played.phase_rad) / (2 * np.pi) * 7)
        if time_s < edges[0] + 4 * played.period_s - 1e-3:
            assert level == SEVEN[sector % 7]
    opened = {record["camera"]: record["opened_s"] for record in rig.records}
    assert not opened or max(opened.values()) < edges[0]


def test_the_frame_was_lit_by_the_code(slow, trigger, shaker, camera):
    shaker.set(12.0, 0.1)
    _, played = fire(trigger)
    assert camera.wait_file(60) is not None
    record = next(record for record in slow.rig.records if record["camera"] == "left")
    opened, exposure = record["opened_s"], record["exposure_s"]
    play = slow.rig._lamp.play(opened, opened + exposure, 0.0, 0.0)
    assert play is not None
    t = opened + (np.arange(50_000) + 0.5) / 50_000 * exposure
    light = play(t)
    assert light.mean() * exposure == pytest.approx(4 / 12.0 * 4 / 7, rel=1e-3)
    phase = np.array([slow.rig.excitation_phase(float(at)) for at in t[::50]])
    share = np.sum(light[::50] * np.exp(1j * phase)) / light[::50].sum()
    sectors = np.exp(2j * np.pi * (np.arange(7) + 0.5) / 7) * np.sinc(1 / 7)
    expected = np.dot(SEVEN, sectors) / sum(SEVEN) * np.exp(1j * played.phase_rad)
    assert abs(share - expected) < 0.01


def test_a_late_thread_of_the_box_takes_no_light_from_a_frame(spec, tmp_path, monkeypatch):
    """On a busy computer the shutter's thread may come first; with the box's stopped it always does."""
    late = SimulatedRig(spec, cards=tmp_path, enable_wired=False)
    jobs: list[ExposureJob] = []
    try:
        late.trigger.shut_down()
        monkeypatch.setattr(late._pool, "render", lambda job: jobs.append(job) or b"")
        opened_s = late.clock() - 1.0
        late.rig.drive(opened_s - 1.0, frequency_hz=12.0, level_v=0.1, running=True)
        late.lamp.armed = ArmedCode(tuple(int(255 * level) for level in SEVEN), 4, EXPOSURE_S, 0.0)
        late.lamp.begin(1, opened_s - 0.06, (opened_s, opened_s))
        late.bus.cameras["left"].body._exposer.expose(opened_s, EXPOSURE_S, iso=100, f_number=32.0)
    finally:
        late.shut_down()
    lamp = jobs[0].lamp
    assert lamp is not None
    t = opened_s + (np.arange(20_000) + 0.5) / 20_000 * EXPOSURE_S
    assert replace(lamp, ambient=0.0)(t).mean() * EXPOSURE_S == pytest.approx(4 / 12.0 * 4 / 7, rel=1e-3)


def test_constant_light_before_and_after(slow, trigger, shaker, eventually):
    shaker.set(12.0, 0.1)
    trigger.set_lamp(0.5)
    assert slow.rig._lamp.levels[-1] == pytest.approx(128 / 255)
    fire(trigger)
    assert eventually(lambda: not slow.lamp.is_busy(), 30.0)
    levels = slow.rig._lamp.levels
    assert levels[0] == levels[-1] == pytest.approx(128 / 255)
    assert levels[1] == levels[-2] == 0.0
    with pytest.raises(UsageError):
        trigger.set_lamp(1.5)


def test_cosine_light_needs_levels(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    cosine = tuple(float(value) for value in (1 + np.cos((np.arange(64) + 0.5) * 2 * np.pi / 64)) / 2)
    _, played = fire(trigger, cosine, 3)
    assert np.abs(np.array(played.brightness) - cosine).max() <= 0.5 / 255 + 1e-12
    slow.lamp.levels = 2
    trigger._lamp.forget()
    with pytest.raises(DeviceRefused, match="only switches"):
        trigger.fire_coded(EXPOSURE_S, LightRequest(cosine, 3), frequency_hz=12.0)
    assert slow.trigger._last_shot == 1


@pytest.mark.parametrize(
    ("code", "cycles", "error", "message"),
    [
        (SEVEN, 7, DeviceRefused, "do not fit"),
        ((1.0,), 3, UsageError, "2 to 64 sectors"),
        ((1.0, 2.0), 3, UsageError, "brightness 0 to 1"),
        ((1.0, 0.0), 0, UsageError, "cannot be played"),
    ],
)
def test_codes_that_cannot_be_played_fire_nothing(rig, trigger, shaker, code, cycles, error, message):
    shaker.set(12.0, 0.1)
    with pytest.raises(error, match=message):
        trigger.fire_coded(EXPOSURE_S, LightRequest(code, cycles), frequency_hz=12.0)
    assert rig.trigger._last_shot == 0
    assert rig.lamp.armed is None


def test_without_sync_a_code_is_refused_by_name(rig, trigger):
    with pytest.raises(DeviceRefused, match="NOSYNC"):
        trigger.fire_coded(EXPOSURE_S, LightRequest(SEVEN, 2), frequency_hz=12.0)
    assert rig.trigger._last_shot == 0


def test_a_sync_of_another_frequency_is_refused(rig, trigger, shaker):
    shaker.set(12.0, 0.1)
    with pytest.raises(DeviceError, match="sees 12 Hz on its sync input where the excitation has 11 Hz"):
        trigger.fire_coded(EXPOSURE_S, LightRequest(SEVEN, 2), frequency_hz=11.0)
    assert rig.lamp.armed is None


def test_firmware_that_does_not_know_codes_is_named(rig, trigger, shaker):
    shaker.set(12.0, 0.1)
    rig.lamp.faults.inject("old_firmware")
    for call in (lambda: trigger.set_lamp(1.0), lambda: fire(trigger)):
        with pytest.raises(DeviceRefused, match="firmware is of before the lamp output"):
            call()
    assert set(trigger.fire(0.01).opening_s) == {"left", "right"}  # all else works


def test_a_box_without_a_lamp_output_is_named(rig, trigger):
    rig.trigger.lamp = None
    with pytest.raises(DeviceRefused, match="no lamp output"):
        trigger.set_lamp(1.0)


def test_a_code_that_is_cut_is_no_measurement(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    slow.lamp.faults.inject("code_cut", count=1)
    with pytest.raises(DeviceError, match=r"played 1 of 4 cycles .* lost, changed or drifted"):
        fire(trigger)


def test_contacts_that_do_not_close_leave_the_code_unplayed(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    slow.lamp.contact_patience_s = 0.3
    slow.trigger.faults.inject("no_contact", count=1)
    with pytest.raises(DeviceError, match="played 0 of 4 cycles"):
        fire(trigger)


def test_a_box_that_restarts_while_it_plays_is_noticed(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    trigger.fire_coded(EXPOSURE_S, LightRequest(SEVEN, 4), frequency_hz=12.0)
    slow.trigger.faults.inject("reboots", count=1)
    with pytest.raises(DeviceError, match="restarted meanwhile"):
        trigger.read_played(30.0)
    assert slow.rig._lamp.levels[-1] == 1.0  # and the light is back on


def test_a_shot_right_after_a_code_waits_for_the_light(slow, trigger, shaker):
    """A light that has not settled when the next shutter opens leaves an image that is lit unevenly."""
    shaker.set(12.0, 0.1)
    for _ in range(2):
        fire(trigger)
    trigger.set_lamp(1.0)
    begin = slow.clock()
    firing = trigger.fire(0.01)
    assert firing.opening_s
    assert slow.rig._lamp.levels[-1] == 1.0
    assert slow.rig._lamp.times_s[-1] < begin
    assert slow.trigger._last_shot == 3


def test_bodies_that_open_far_apart_are_named_with_the_key_that_helps(slow, trigger, shaker):
    """Lags of 62 and 153 ms: what both shutters see is 90 ms shorter than the exposure."""
    shaker.set(12.0, 0.1)
    slow.bus.cameras["right"].body._exposer.lag_s += 0.09
    assert fire(trigger, cycles=4)[1].cycles == 4
    with pytest.raises(DeviceError, match="raise margin_s"):
        fire(trigger, cycles=5)


def test_a_code_that_another_shot_took_is_not_credited_to_ours(slow, trigger, shaker, eventually):
    shaker.set(12.0, 0.1)
    trigger.wait(0.0)
    trigger._lamp.arm(LightRequest(SEVEN, 4), EXPOSURE_S, 12.0)
    slow.trigger.external_edge()
    assert eventually(lambda: bool(slow.lamp.plays) and not slow.lamp.is_busy(), 30.0)
    trigger._lamp.fired(trigger._release("FIRE 500000", 30.0).number, EXPOSURE_S)
    with pytest.raises(DeviceError, match="another shot took the code"):
        trigger.read_played(30.0)


def test_a_second_code_while_one_is_played_is_refused(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    for camera in slow.bus.cameras.values():  # long enough for a busy machine to ask for the second one meanwhile
        camera.body.settings.set(Prop.EXPOSURE_TIME, 200_000)
    trigger.fire_coded(20.0, LightRequest(SEVEN, 230), frequency_hz=12.0)
    with pytest.raises(DeviceRefused, match="BUSY"):
        trigger.fire_coded(EXPOSURE_S, LightRequest(SEVEN, 4), frequency_hz=12.0)
    with pytest.raises(DeviceRefused, match="BUSY"):
        trigger.fire(0.01)


def test_a_lost_answer_arms_and_fires_once(slow, trigger, shaker):
    shaker.set(12.0, 0.1)
    slow.trigger.faults.inject("silent", count=2)
    fire(trigger)
    assert slow.trigger._last_shot == 1


def test_the_enable_line_does_not_notice_a_code(spec, tmp_path, make_shaker):
    wired = SimulatedRig(spec, cards=tmp_path)
    for camera in wired.bus.cameras.values():
        camera.body.settings.set(Prop.EXPOSURE_TIME, 5000)
    set_default_rig(wired)
    try:
        box = TriggerBox("trigger", {"port": "sim://trigger", "hold_enable_ms": 4000})
        box.connect()
        shaker = make_shaker()
        box.raise_enable()
        stop = threading.Event()

        def beat() -> None:
            while not stop.wait(0.05):
                box.heartbeat()

        beats = threading.Thread(target=beat)
        beats.start()
        try:
            shaker.set(12.0, 0.1)
            fire(box)
        finally:
            stop.set()
            beats.join()
        assert wired.trigger.enable_up
        # Dropped in the middle of a code it falls at once. The code is long, so that a busy machine is not too late.
        for camera in wired.bus.cameras.values():
            camera.body.settings.set(Prop.EXPOSURE_TIME, 40_000)
        box.heartbeat()
        box.fire_coded(4.0, LightRequest(SEVEN, 44), frequency_hz=12.0)
        box.drop_enable()
        assert not wired.trigger.enable_up
        with pytest.raises(DeviceError):
            box.read_played(30.0)
        box.close()
    finally:
        set_default_rig(None)
        wired.shut_down()


def test_over_a_pty(slow, shaker):
    shaker.set(12.0, 0.1)
    port = PtyPort(slow.trigger)
    driver = TriggerBox("trigger", {"port": port.path, "timeout_s": 0.5})
    driver.connect()
    _, played = fire(driver)
    assert played.cycles == 4
    driver.close()
    port.close()


def test_who_can_play() -> None:
    assert plays_light(TriggerBox("trigger", {"port": "sim://trigger"}))
    assert not plays_light(RtsTrigger("trigger", {"port": "sim://shutter"}))


class Pin:
    """Edges of the output, a later call voids what was planned for later."""

    def __init__(self) -> None:
        self.edges: list[tuple[float, float]] = []

    def __call__(self, t: float, level: float) -> None:
        self.edges = [edge for edge in self.edges if edge[0] < t] + [(t, level)]

    def at(self, t: float) -> float:
        return next((level for time_s, level in reversed(self.edges) if time_s <= t + 1e-12), 1.0)


@pytest.mark.parametrize(("drift", "state"), [(2e-4, "DONE"), (3e-3, "CUT"), (-3e-3, "CUT")])
def test_an_excitation_whose_rate_drifts_ends_the_code(drift: float, state: str) -> None:
    """Over 13 cycles 0.3 % turn the phase by 7 degrees, although no single period differs by 1 %."""
    pin, frequency = Pin(), 13.0
    lamp = LampOutput(pin)
    lamp.restart(0.0)

    def sync(t: float) -> tuple[float, float]:
        rate = drift * frequency / 2  # per second, of the frequency's relative change
        phase = frequency * (t + rate * t * t / 2 / frequency)
        now = frequency + rate * t
        return t - (phase % 1) / now, 1 / now

    lamp.armed = ArmedCode((255, 0, 255, 0, 0), 13, 1.2, 0.0)
    lamp.begin(1, 0.0, (0.06,))
    for now in np.linspace(0.0, 1.2, 60):
        lamp.advance(float(now), sync)
    assert lamp.plays[1].state == state
    assert pin.at(1.2) == 0.0


@settings(max_examples=60, deadline=None)
@given(
    levels=st.lists(st.integers(0, 255), min_size=2, max_size=16),
    frequency=st.floats(2.0, 40.0),
    edge=st.floats(0.0, 1.0),
    turn=st.floats(0.0, 1.0),
    tick_error=st.floats(-5e-3, 5e-3),
    lag=st.floats(0.03, 0.2),
    steps=st.integers(3, 40),
)
def test_whatever_the_timing_the_light_follows_the_code(levels, frequency, edge, turn, tick_error, lag, steps):
    """Property: whole cycles, each sector at its phase, all inside the open shutters, dark around them."""
    period, cycles, open_s = 1 / frequency, 3, 5 / frequency + 0.05
    pin = Pin()
    lamp = LampOutput(pin, tick_error=tick_error)
    lamp.restart(0.0)

    def sync(t: float) -> tuple[float, float]:
        return edge + math.floor((t - edge) / period) * period, period

    lamp.armed = ArmedCode(tuple(levels), cycles, open_s, turn)
    assert lamp.refusal(lamp.armed, period) is None
    lamp.begin(1, 2.0, (2.0 + lag, 2.002 + lag))
    for now in np.linspace(2.0, 2.5 + lag + open_s, steps * 7):  # the box looks at any times
        lamp.advance(float(now), sync)
    play = lamp.plays[1]
    assert play.state == "DONE"
    assert play.start_s is not None
    assert 2.002 + lag < play.start_s < 2.002 + lag + 1e-3 + period / len(levels) + 1e-6
    assert play.start_s + cycles * period < 2.0 + lag + open_s
    assert pin.at(2.0 + lag) == 0.0
    assert pin.at(play.start_s + cycles * period * 1.0001 + 1e-5) == 0.0
    assert pin.at(2.3 + lag + open_s) == 1.0
    for t in play.start_s + (np.arange(cycles * 40) + 0.5) / 40 * period:
        place = ((t - edge) / period - turn) * len(levels) % len(levels)
        if min(place % 1, 1 - place % 1) > 0.02:
            assert pin.at(t) == levels[int(place)] / 255
