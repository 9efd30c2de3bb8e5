"""The rig file: ours load, and every mistake is named with its path."""

from __future__ import annotations

import math
import random
import re
import tomllib
from pathlib import Path

import pytest

from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.plan import make_plan
from labdaemon.errors import ConfigError, DataError, LabdaemonError, LimitError
from labdaemon.service.config import RigConfig, load_rig, plan_rig
from labdaemon.service.lamp_settings import lamp_of
from labdrivers.sim.rig_file import rig_toml
from labdrivers.sim.spec import RigSpec

CONFIG = Path(__file__).parents[2] / "config"
SIM = (CONFIG / "sim.toml").read_text()


def written(tmp_path: Path, *changes: tuple[str, str], drop: str | None = None) -> Path:
    """The simulated rig's file with some changes."""
    text = SIM
    for before, after in changes:
        assert before in text, before
        text = text.replace(before, after, 1)
    if drop:
        text = re.sub(rf"\[{drop}\].*?(?=\n\[)", "", text, flags=re.S)
    (tmp_path / "rig.toml").write_text(text)
    for name in ("sim-control.csv", "sim-targets.csv"):
        (tmp_path / name).write_text((CONFIG / name).read_text())
    return tmp_path / "rig.toml"


@pytest.mark.parametrize("name", ["sim.toml", "lab.toml"])
def test_our_own_files_load_to_the_last_driver_key(name: str) -> None:
    rig = load_rig(CONFIG / name)
    assert list(rig.cameras) == ["left", "right"]
    assert rig.limits is not None


def test_the_simulated_rig_is_described_as_it_is() -> None:
    spec = RigSpec()
    assert tomllib.loads(SIM) == tomllib.loads(rig_toml(spec))
    assert (CONFIG / "sim-control.csv").read_text() == spec.control_csv()
    assert (CONFIG / "sim-targets.csv").read_text() == spec.targets_csv()
    limits = load_rig(CONFIG / "sim.toml").limits
    assert limits is not None
    assert limits.stroke_mm == spec.table.stroke_mm
    assert limits.frequency_hz == spec.table.frequency_hz


def test_shaker_gauges_and_trigger_are_optional(tmp_path: Path) -> None:
    text = re.sub(r"\[shaker\].*?(?=\[cameras\.left\])", "", SIM, flags=re.S)
    path = written(tmp_path)
    path.write_text(text)
    rig = load_rig(path)
    assert (rig.shaker, rig.limits, rig.gauges, rig.trigger.driver) == (None, None, (), "camera")
    assert plan_rig(rig).limits is None
    assert not plan_rig(rig).can_fire
    assert plan_rig(load_rig(CONFIG / "sim.toml")).can_fire


def test_paths_start_at_the_files_folder(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path, ('data = "../data/sim"', 'data = "out"')))
    assert rig.data == tmp_path / "out"
    assert rig.path(rig.control.file) == tmp_path / "sim-control.csv"


def test_a_driver_gets_what_was_written(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path))
    assert rig.cameras["left"].settings["backend"] == "sim"
    assert rig.shaker_settings()["limits"]["stroke_mm"] == 150.0
    assert "exposure_steps_s" not in rig.cameras["left"].settings


def test_the_digest_knows_what_results_depend_on(tmp_path: Path) -> None:
    base = load_rig(written(tmp_path)).digest
    same = [
        ('data = "../data/sim"', 'data = "x"'),
        ("5571", "6571"),
        ("[interlocks]", "[processing]\nworkers = 1\n\n[interlocks]"),
    ]
    other = [
        ("stroke_mm = 150.0", "stroke_mm = 140.0"),
        ("3937.7, 3937.7", "3937.8, 3937.8"),
        ("size_mm = 36.0", "size_mm = 30.0"),
    ]
    assert {load_rig(written(tmp_path, change)).digest for change in same} == {base}
    assert base not in {load_rig(written(tmp_path, change)).digest for change in other}
    path = written(tmp_path)
    survey = tmp_path / "sim-control.csv"
    survey.write_text(survey.read_text().replace(",0.05", ",0.06"))
    assert load_rig(path).digest != base


def test_exposure_names_become_true_times(tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path))
    planned = plan_rig(rig, exposure_steps_s={"left": (1.0, 1.3), "right": (1.0,)}, free_bytes=5)
    assert planned.exposure_steps_s == {"left": (1.0, pytest.approx(2 ** (1 / 3))), "right": (1.0,)}
    assert planned.free_bytes == 5
    assert math.isclose(planned.frame_bytes["left"], 3900 * 2613 * 2)
    listed = load_rig(written(tmp_path, ('serial = "6000001"', 'serial = "6000001"\nexposure_steps_s = [0.5, 1.0]')))
    assert plan_rig(listed).exposure_steps_s["left"] == (0.5, 1.0)


def test_the_drivers_calibration_bounds_the_plan_too() -> None:
    planned = plan_rig(load_rig(CONFIG / "sim.toml"))
    assert planned.refusal(8.0, 1.0) is None
    assert "calibrated from 2 to 30 Hz" in (planned.refusal(40.0, 0.1) or "")
    assert "at least" in (planned.refusal(8.0, 1e-4) or "")
    campaign = load_campaign('name = "far"\n[[phase]]\nkind = "steps"\nfrequency_hz = [8, 40]\namplitude_mm = 0.1\n')
    with pytest.raises(LimitError, match="calibrate there first") as caught:
        make_plan(campaign, planned)
    assert caught.value.key == "phase[0].amplitude_mm"


MISTAKES: list[tuple[tuple[str, str], str, str]] = [
    (('driver = "scpi"', 'driver = "scpy"'), "shaker.driver", "did you mean scpi"),
    (('driver = "ptp"', 'driver = "webcam"'), "cameras.left.driver", "installed are"),
    (('"sim-control.csv"', f'"{"x" * 2000}"'), "control.file", "is not there"),
    (('"sim-targets.csv"', f'"{"x" * 2000}"'), "targets.file", "is not there"),
    (('"apriltag-36h11"', '"apriltag"'), "control.family", "no control targets are called 'apriltag'"),
    (("stroke_mm = 150.0", "stroke_m = 0.15"), "shaker.limits.stroke_m", "did you mean stroke_mm"),
    (("stroke_mm = 150.0", "stroke_mm = 0.15"), "shaker.limits.stroke_mm", "greater than or equal to 1"),
    (("stroke_mm = 150.0", ""), "shaker.limits.stroke_mm", "missing"),
    (("stroke_mm = 150.0", 'stroke_mm = "150"'), "shaker.limits.stroke_mm", "number"),
    (("frequency_hz = [0.5, 50.0]", "frequency_hz = [50.0, 0.5]"), "shaker.limits.frequency_hz", "lowest"),
    (("frequency_hz = [0.5, 50.0]", "force_n = 100.0"), "shaker.limits", "moving_mass_kg"),
    (("[service]", "[servce]"), "servce", "did you mean service"),
    (("[control]", "[controls]"), "controls", "did you mean control"),
    (("5571", "5570"), "service", "share an address"),
    (("tcp://127.0.0.1:5570", "ipc://run/a"), "service.commands", "no absolute path"),
    (("tcp://127.0.0.1:5570", "ipc:///" + "a" * 100), "service.commands", "at most 90 bytes"),
    (("[service]", '[service]\nlocal_operators = "me"'), "service.local_operators", "group:NAME"),
    (("[service]", '[service]\nlocal_operators = "owner"'), "service", "local_operators = keys"),
    (("[service]", "[service]\nhistory_days = 0"), "service.history_days", "greater than or equal to 0.01"),
    (("tcp://127.0.0.1:5570", "5570"), "service.commands", "no address"),
    (("127.0.0.1:5570", "127.0.0.1:70000"), "service.commands", "no address"),
    (('serial = "6000002"', 'serial = "6000001"'), "cameras.right.serial", "camera left's already"),
    (('serial = "6000002"', "serial = 6000002"), "cameras.right.serial", "string"),
    (('name = "response"', 'name = "table"'), "gauge[1].name", "another gauge's"),
    (('role = "response"', 'role = "respons"'), "gauge[1].role", "'response'"),
    (("iso = 100", "iso = 100.5"), "cameras.left.iso", "integer"),
    (("focal_px = [3937.7, 3937.7]", "focal_mm = [24.0, 24.0]"), "cameras.left.focal_mm", "did you mean focal_px"),
    (("principal_point_px = [1956.8, 1296.2]", ""), "cameras.left", "principal_point_px is not"),
    (("-0.0002, 0.0]", "-0.0002]"), "cameras.left.distortion[4]", "missing|required"),
    (("diameter_mm = 8.0", "diameter_mm = 0.008"), "targets.diameter_mm", "greater than or equal to 0.5"),
    (("size_mm = 36.0", "size_mm = 0.036"), "control.size_mm", "greater than or equal to 1"),
    (('file = "sim-control.csv"', 'file = "nowhere.csv"'), "control.file", "not there"),
    (("max_response_mm = 60.0", "max_respons_mm = 60.0"), "interlocks.max_respons_mm", "did you mean max_response_mm"),
    (("max_response_mm = 60.0", "max_response_mm = -1.0"), "interlocks.max_response_mm", "greater than 0"),
    (("levels = 256", "levels = 1"), "lamp.levels", "greater than or equal to 2"),
    (("rise_s = 1e-4", "rise_ms = 0.1"), "lamp.rise_ms", "did you mean rise_s"),
    (("levels = 256", 'output = "gpio"'), "lamp.output", "'trigger'"),
    (("ambient = 0.05 ", "mains_hz = 55\nambient = 0.05 "), "lamp.mains_hz", "50"),
    (('port = "sim://shaker"', 'prot = "sim://shaker"\nport = "x"'), "shaker.prot", "did you mean port"),
    (('backend = "sim"', 'backnd = "sim"'), "cameras.left.backnd", "did you mean backend"),
]


@pytest.mark.parametrize(("change", "key", "words"), MISTAKES, ids=[key for _, key, _ in MISTAKES])
def test_mistakes_are_named_with_their_path(tmp_path: Path, change: tuple[str, str], key: str, words: str) -> None:
    path = written(tmp_path, change)
    with pytest.raises(ConfigError, match=words) as caught:
        load_rig(path)
    assert caught.value.key == key
    assert str(caught.value).startswith(f"{path}: {key}: ")
    assert "\n" not in str(caught.value)


def test_a_camera_that_is_not_calibrated_is_refused_with_the_way_to_calibrate(tmp_path: Path) -> None:
    path = written(tmp_path)
    for key in ("focal_px", "principal_point_px", "distortion"):
        path.write_text(re.sub(rf"{key} = .*\n", "", path.read_text(), count=1))
    with pytest.raises(ConfigError, match="labdaemon calibrate camera") as caught:
        load_rig(path)
    assert caught.value.key == "cameras.left"
    assert load_rig(path, check_files=False).limits is not None  # enough to stop the table


def test_a_survey_that_is_none_is_told_before_anything_runs(tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "sim-control.csv").write_text("name,x_mm,y_mm,z_mm,sd_mm\n0,1,2,3,0.1\n")
    with pytest.raises(DataError, match=r"sim-control\.csv"):
        load_rig(path)
    assert load_rig(path, check_files=False).limits is not None  # enough to stop the table


def test_mutilated_files_end_in_one_line(tmp_path: Path) -> None:
    values = ["-1", "1e308", "nan", '""', '"x"', "[]", "[[1]]", "{}", "true", "1979-05-27", '"\\u0000"', '"../.."']
    refusals: list[LabdaemonError] = []
    randomness = random.Random(7)
    path = written(tmp_path)
    for _ in range(150):
        lines = SIM.splitlines()
        for _ in range(randomness.randint(1, 3)):
            place = randomness.randrange(len(lines))
            if "=" in lines[place] and randomness.random() < 0.6:
                lines[place] = lines[place].partition("=")[0] + "= " + randomness.choice(values)
            else:
                lines.insert(place, lines.pop(randomness.randrange(len(lines))))
        path.write_text("\n".join(lines))
        try:
            plan_rig(load_rig(path))
        except LabdaemonError as exc:
            refusals.append(exc)
    assert len(refusals) > 50
    assert all("\n" not in str(exc) and exc.exit_status == 2 for exc in refusals)


def test_no_cameras_is_an_error(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(re.sub(r"\[cameras\.left\].*?(?=\[targets\])", "[cameras]\n", SIM, flags=re.S))
    with pytest.raises(ConfigError, match="cameras"):
        load_rig(path)


def test_one_gauge_in_single_brackets_is_told(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(
        re.sub(r"\[\[gauge\]\]\nname = \"response\".*?(?=\[cameras)", "", SIM, flags=re.S).replace(
            "[[gauge]]", "[gauge]"
        )
    )
    with pytest.raises(ConfigError, match="double brackets"):
        load_rig(path)


def test_the_config_is_frozen(tmp_path: Path) -> None:
    rig: RigConfig = load_rig(written(tmp_path))
    with pytest.raises(ValueError, match="frozen"):
        rig.service.data = "elsewhere"  # type: ignore[misc]


@pytest.mark.parametrize("driver", ["rts", "camera"])
def test_a_lamp_that_the_trigger_cannot_play_is_no_lamp(driver: str) -> None:
    rig = load_rig(CONFIG / "sim.toml")
    assert lamp_of(rig) is not None
    other = rig.model_copy(update={"trigger": rig.trigger.model_copy(update={"driver": driver})})
    assert lamp_of(other) is None  # the rig serves; plans with coded light are refused
