"""From a campaign's text to a plan, and every mistake in it named with its path."""

from __future__ import annotations

import itertools
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.plan import PlanRig, make_plan
from labdaemon.campaign.steps import Plan
from labdaemon.capture.exposure import third_stop_steps_s
from labdaemon.capture.settle import settling_time_s
from labdaemon.errors import ConfigError, LabdaemonError, LimitError

TABLE = ShakerLimits(150.0, 1000.0, 20000.0, (0.5, 50.0))
STEPS_S = third_stop_steps_s()
RIG = PlanRig(TABLE, {"left": STEPS_S, "right": STEPS_S}, {"left": 20_000_000, "right": 20_000_000})
NO_SHAKER = PlanRig(None, {"left": STEPS_S}, {"left": 20_000_000})
SHARP = '[[phase]]\nkind = "sharp"\nframes = 2\n'
THREE_MODES = Path(__file__).parents[2] / "config" / "campaigns" / "three-modes.toml"


def plan(phases: str, rig: PlanRig = RIG, head: str = "") -> Plan:
    return make_plan(load_campaign(f'name = "test"\n{head}{phases}'), rig)


def steps_phase(rest: str = "", frequency: str = "5.0", amplitude: str = "1.0") -> str:
    return f'[[phase]]\nkind = "steps"\nfrequency_hz = {frequency}\namplitude_mm = {amplitude}\n{rest}\n'


def test_three_modes() -> None:
    made = make_plan(load_campaign(THREE_MODES), RIG)
    assert [step.kind for step in made.steps] == ["sharp", "steps", "steps", "steps"]
    assert [(step.frequency_hz, step.amplitude_mm) for step in made.steps[1:]] == [(5, 2), (8, 1), (12, 0.5)]
    assert [step.shots[0].cycles for step in made.steps] == [None, 5.0, 8.0, 12.0]
    assert len(made.steps[0].shots) == 3
    assert [step.index for step in made.steps] == [0, 1, 2, 3]
    assert made.predicted_bytes == 6 * 40_000_000
    assert made.predicted_s == pytest.approx(
        12 + 3 * (2 + 4) + sum(settling_time_s(f, 0.01) for f in (5, 8, 12)), abs=0.1
    )


@pytest.mark.parametrize("path", sorted(THREE_MODES.parent.glob("*.toml")), ids=lambda path: path.stem)
def test_the_campaigns_in_config_can_be_walked_on_the_simulated_rig(path: Path) -> None:
    made = make_plan(load_campaign(path), RIG)
    assert made.name == path.stem
    assert made.steps[0].kind == "sharp"


def test_settling_is_the_measured_time() -> None:
    assert settling_time_s(5.0, 0.01) == pytest.approx(22.0, abs=0.1)  # the textbook case: 5 Hz at 1 %


def test_spacing_includes_both_ends() -> None:
    made = plan(SHARP + steps_phase(frequency='{ start = 4, stop = 14, count = 21, spacing = "log" }'))
    walked = [step.frequency_hz for step in made.steps[1:]]
    assert (walked[0], walked[-1], len(walked)) == (4.0, 14.0, 21)
    ratios = [b / a for a, b in itertools.pairwise(walked) if a and b]
    assert ratios == pytest.approx([ratios[0]] * 20)


def test_both_directions_turn_at_the_end_without_repeating_it() -> None:
    made = plan(SHARP + steps_phase("both_directions = true", "[5, 8, 12]", "[2, 1, 0.5]"))
    assert [(s.frequency_hz, s.amplitude_mm) for s in made.steps[1:]] == [(5, 2), (8, 1), (12, 0.5), (8, 1), (5, 2)]


def test_repeats_of_phase_and_campaign() -> None:
    made = plan(SHARP + steps_phase("repeats = 3"), head="repeats = 2\n")
    assert [step.kind for step in made.steps] == (["sharp"] + ["steps"] * 3) * 2
    assert [step.sharp_set for step in made.steps] == [""] * 4 + ["set-002"] * 4


def test_captures_at_phases_are_grouped_and_half_a_cycle_from_whole() -> None:
    made = plan(SHARP + steps_phase("phase_rad = [0.0, 1.5708]\ncaptures = 2"))
    groups = made.steps[1:]
    assert [step.grouped for step in groups] == [True, True]
    assert [shot.phase_rad for shot in groups[0].shots] == [0.0, 1.5708]
    cycles = groups[0].shots[0].cycles
    assert cycles is not None
    assert abs(cycles - round(cycles)) > 0.25


def test_a_single_phase_is_no_group() -> None:
    assert not plan(SHARP + steps_phase("phase_rad = [0.5]\ncaptures = 2")).steps[1].grouped


def test_sharp_sets_are_retaken_after_so_many_steps() -> None:
    made = plan('[[phase]]\nkind = "sharp"\nevery_steps = 2\n' + steps_phase("repeats = 5"))
    assert [step.kind for step in made.steps] == ["sharp", "steps", "steps"] * 2 + ["sharp", "steps"]
    assert [step.sharp_set for step in made.steps][::3] == ["", "set-002", "set-003"]


def test_sharp_sets_are_retaken_after_so_long() -> None:
    made = plan('[[phase]]\nkind = "sharp"\nevery_s = 60\n' + steps_phase("repeats = 20"))
    since_s = 0.0
    for step in made.steps:
        since_s = 0.0 if step.kind == "sharp" else since_s + step.predicted_s
        assert since_s < 60 + step.predicted_s
    assert sum(step.kind == "sharp" for step in made.steps) > 3


def test_a_campaign_without_sharp_frames_gets_a_set_first() -> None:
    made = plan(steps_phase())
    assert [step.kind for step in made.steps] == ["sharp", "steps"]


def test_a_sweep_at_constant_acceleration() -> None:
    made = plan(
        SHARP + '[[phase]]\nkind = "sweep"\nfrequency_hz = { start = 5, stop = 20, count = 4 }\n'
        "acceleration_mm_s2 = 1000.0\nboth_directions = true\n"
    )
    steps = made.steps[1:]
    assert [step.frequency_hz for step in steps] == [5, 10, 15, 20, 15, 10, 5]
    for step in steps:
        assert step.frequency_hz is not None
        assert step.amplitude_mm == pytest.approx(1000 / (2 * 3.141592653589793 * step.frequency_hz) ** 2)


def test_dwell_external_and_pause() -> None:
    made = plan(
        SHARP + '[[phase]]\nkind = "dwell"\nfrequency_hz = 5\namplitude_mm = 1\nhold_s = 600\n'
        '[[phase]]\nkind = "external"\ncaptures = 4\nwait_s = 120\n[[phase]]\nkind = "pause"\nduration_s = 30\n'
        '[[phase]]\nkind = "pause"\n'
    )
    dwell, external, pause, wait = made.steps[1:]
    assert (dwell.hold_s, len(dwell.shots)) == (600, 1)
    assert dwell.predicted_s > 600 + settling_time_s(5, 0.01)
    assert (external.hold_s, len(external.shots), external.frequency_hz) == (120, 4, None)
    assert (pause.hold_s, pause.shots, pause.predicted_s) == (30, (), 30)
    assert wait.hold_s == 0


def test_an_outside_system_may_open_at_phases_that_it_states() -> None:
    text = '[[phase]]\nkind = "external"\nfrequency_hz = 5\ncaptures = 2\nphase_rad = [0.0, 1.5708]\nlabel = "vc"\n'
    groups = plan(SHARP + text, NO_SHAKER).steps[1:]
    assert [[shot.phase_rad for shot in step.shots] for step in groups] == [[0.0, 1.5708]] * 2
    assert [step.grouped for step in groups] == [True, True]
    with pytest.raises(ConfigError, match="two of the phases are the same"):
        plan(SHARP + text.replace("1.5708", "6.2831853"), NO_SHAKER)


def test_labels_are_unique_and_sort_in_order() -> None:
    made = plan(SHARP + steps_phase("repeats = 12\nlabel = 'night'"))
    labels = [step.label for step in made.steps]
    assert labels == sorted(set(labels))
    assert labels[1] == "00001-night-5.000hz"


def test_the_same_text_on_another_rig_is_another_plan() -> None:
    campaign = load_campaign(f'name = "test"\n{SHARP}')
    one, other = make_plan(campaign, RIG), make_plan(campaign, PlanRig(TABLE, RIG.exposure_steps_s, digest="x"))
    assert one.digest != other.digest
    assert one.digest == make_plan(campaign, RIG).digest


@pytest.mark.parametrize(
    ("phases", "key", "words"),
    [
        (steps_phase(frequency="[5, 8]", amplitude="[2, 80]"), "phase[0].amplitude_mm[1]", "at most 7.91 mm"),
        (steps_phase(frequency="[5, 8]", amplitude="9.0"), "phase[0].amplitude_mm", "acceleration"),
        (steps_phase(frequency="[5, 60]"), "phase[0].frequency_hz[1]", "0.5 to 50 Hz"),
        (
            steps_phase(frequency="{ start = 4, stop = 60, count = 9 }", amplitude="0.05"),
            "phase[0].frequency_hz",
            "outside",
        ),
        (steps_phase("exposure_s = 200"), "phase[0].exposure_s", "no camera step"),
        (
            '[[phase]]\nkind = "sweep"\nfrequency_hz = { start = 5, stop = 20, count = 4 }\nvelocity_mm_s = 2000',
            "phase[0].velocity_mm_s",
            "at most",
        ),
        (
            '[[phase]]\nkind = "dwell"\nfrequency_hz = 8\namplitude_mm = 20\nhold_s = 5',
            "phase[0].amplitude_mm",
            "at most",
        ),
    ],
)
def test_what_the_rig_cannot_do_is_named(phases: str, key: str, words: str) -> None:
    with pytest.raises(LimitError, match=words) as caught:
        plan(phases)
    assert caught.value.key == key
    assert caught.value.exit_status == 2


def test_a_dial_that_decides_is_told() -> None:
    with pytest.raises(LimitError, match=r"only 0.01 s .*dial"):
        plan(SHARP, PlanRig(TABLE, {"left": (0.01,)}))


def test_a_full_disk_is_told_before() -> None:
    with pytest.raises(LimitError, match="GB of disk"):
        plan(SHARP, PlanRig(TABLE, RIG.exposure_steps_s, RIG.frame_bytes, free_bytes=10_000_000))


def test_a_rig_without_shaker_waits_for_others() -> None:
    assert plan('[[phase]]\nkind = "external"\nfrequency_hz = 5', NO_SHAKER).steps[1].shots[0].cycles == 5
    with pytest.raises(ConfigError, match="external"):
        plan(steps_phase(), NO_SHAKER)
    with pytest.raises(ConfigError, match="no trigger of ours"):
        plan(steps_phase(), PlanRig(TABLE, RIG.exposure_steps_s, can_fire=False))


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("nam = 'x'", "nam", "did you mean name"),
        ("name = 'x'\n", "phase", "missing"),
        ("name = '../x'\n" + SHARP, "name", "pattern"),
        ("name = 'x'\n[phase]\nkind = 'sharp'", "phase", "double brackets"),
        ("name = 'x'\n[[phase]]\nkind = 'stepz'", "phase[0]", "did you mean steps"),
        ("name = 'x'\n[[phase]]\nframes = 3", "phase[0]", "no kind"),
        ("name = 'x'\n" + SHARP + "frame = 3", "phase[0].frame", "did you mean frames"),
        ("name = 'x'\n" + steps_phase(frequency="[5, -8]"), "phase[0].frequency_hz[1]", "greater than 0"),
        ("name = 'x'\n" + steps_phase(frequency="'5'"), "phase[0].frequency_hz", "number"),
        ("name = 'x'\n" + steps_phase(frequency="true"), "phase[0].frequency_hz", "number"),
        ("name = 'x'\n" + steps_phase(frequency="nan"), "phase[0].frequency_hz", "finite|greater"),
        ("name = 'x'\n" + steps_phase(amplitude="[1, 2]"), "phase[0]", "2 values of amplitude_mm for 1"),
        ("name = 'x'\n" + steps_phase("exposure_ms = 1000"), "phase[0].exposure_ms", "did you mean exposure_s"),
        ("name = 'x'\n" + steps_phase("settle = { timeout = 60 }"), "phase[0].settle.timeout", "timeout_s"),
        ("name = 'x'\n" + steps_phase("on_fault = 'rety'"), "phase[0].on_fault", "'retry'"),
        ("name = 'x'\n" + steps_phase("phase_rad = [0.0, 6.2831853]"), "phase[0].phase_rad", "same"),
        ("name = 'x'\n" + steps_phase("not_before = '25:00'"), "phase[0].not_before", "pattern"),
        ("name = 'x'\n" + steps_phase("captures = 1.5"), "phase[0].captures", "integer"),
        (
            "name = 'x'\n" + steps_phase(frequency="{ start = 4, stop = 9, cnt = 3 }"),
            "phase[0].frequency_hz.cnt",
            "count",
        ),
        (
            "name = 'x'\n[[phase]]\nkind = 'sweep'\nfrequency_hz = { start = 4, stop = 9, count = 3 }",
            "phase[0]",
            "exactly one of amplitude_mm",
        ),
    ],
)
def test_mistakes_are_named_with_their_path(text: str, key: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        load_campaign(text)
    assert caught.value.key == key
    assert "\n" not in str(caught.value)


def test_files_that_are_no_campaign(tmp_path: Path) -> None:
    for name, content, words in (
        ("a.toml", b"name = 'x", "not valid TOML"),
        ("b.toml", b"\xff\xfe", "not UTF-8"),
        ("c.toml", b"#" * (2 << 20), "larger"),
        ("d.toml", b"a = " + b"[" * 5000, "more than 16 brackets"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=words):
            load_campaign(tmp_path / name)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_campaign(tmp_path / "missing.toml")


def test_mutilated_campaigns_end_in_one_line() -> None:
    values = ["-1", "1e308", "nan", '""', "[]", "[[1]]", "{}", "{ start = 1 }", "true", "1979-05-27", "[1, 'a']"]
    whole = THREE_MODES.read_text() + '[[phase]]\nkind = "dwell"\nfrequency_hz = 9.0\namplitude_mm = 0.5\nhold_s = 2\n'
    refusals: list[LabdaemonError] = []
    randomness = random.Random(3)
    for _ in range(400):
        lines = whole.splitlines()
        for _ in range(randomness.randint(1, 3)):
            place = randomness.randrange(len(lines))
            if "=" in lines[place] and randomness.random() < 0.6:
                lines[place] = lines[place].partition("=")[0] + "= " + randomness.choice(values)
            else:
                lines.insert(place, lines.pop(randomness.randrange(len(lines))))
        try:
            make_plan(load_campaign("\n".join(lines)), RIG)
        except LabdaemonError as exc:
            refusals.append(exc)
    assert len(refusals) > 50
    assert all("\n" not in str(exc) and exc.exit_status == 2 for exc in refusals)


def test_a_slip_of_the_pen_does_not_make_a_million_steps() -> None:
    with pytest.raises(LimitError, match="split"):
        plan(SHARP + steps_phase("repeats = 10000\ncaptures = 1"), head="repeats = 100\n")


@settings(max_examples=40, deadline=None)
@given(
    repeats=st.integers(1, 4),
    frequencies=st.lists(st.floats(1, 20), min_size=1, max_size=5),
    captures=st.integers(1, 3),
    every=st.integers(1, 6),
    both=st.booleans(),
)
def test_every_capture_is_planned_once_after_a_sharp_set(
    repeats: int, frequencies: list[float], captures: int, every: int, both: bool
) -> None:
    phase = steps_phase(
        f"repeats = {repeats}\ncaptures = {captures}\nboth_directions = {str(both).lower()}", str(frequencies), "0.1"
    )
    made = plan(f'[[phase]]\nkind = "sharp"\nevery_steps = {every}\n' + phase)
    shaking = [step for step in made.steps if step.kind == "steps"]
    walked = frequencies + frequencies[-2::-1] if both else frequencies
    assert [step.frequency_hz for step in shaking] == walked * repeats
    assert sum(len(step.shots) for step in shaking) == len(walked) * repeats * captures
    assert [step.index for step in made.steps] == list(range(len(made.steps)))
    last = ""
    for step in made.steps:
        last = step.sharp_set if step.kind == "sharp" else last
        assert step.sharp_set == last
    sets = [step.sharp_set for step in made.steps if step.kind == "sharp"]
    assert len(set(sets)) == len(sets) == -(-len(shaking) // every)
