"""Keys of coded light in `capture.toml`: what they mean, and which are refused by name."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from labdaemon.errors import ConfigError
from labdaemon.processing.envelope import _unknown_phases
from labdaemon.processing.folder import CaptureFile, DataFolder, _read_capture

CODE = {"light": [1, 1, 1, 0, 1, 0, 0], "frequency_hz": 5.0, "exposure_s": 1.0, "light_cycles": 4}


def test_ambient_light_has_a_standard_deviation_of_its_own_or_a_default() -> None:
    default = CaptureFile.model_validate({**CODE, "ambient": 0.5}).light_code()
    stated = CaptureFile.model_validate({**CODE, "ambient": 0.5, "sd_ambient": 0.2}).light_code()
    exact = CaptureFile.model_validate({**CODE, "sd_ambient": 0.0}).light_code()
    assert default is not None
    assert stated is not None
    assert exact is not None
    assert default.sd_ambient == pytest.approx(0.012)
    assert stated.sd_ambient == 0.2
    assert exact.sd_ambient == 0.0


def test_the_sd_of_the_codes_phase_reaches_the_fit() -> None:
    window = CaptureFile.model_validate({**CODE, "light_phase_rad": 0.3, "sd_light_phase_rad": 0.01}).window("left")
    assert window is not None
    assert window.light is not None
    assert window.light.sd_phase_rad == 0.01


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("light", [1, 2, 0]),
        ("light", [0, 0, 0]),
        ("light", [1]),
        ("light", "11x0"),
        ("light", [1, float("nan")]),
        ("light_phase_rad", float("inf")),
        ("light_cycles", 0),
        ("light_cycles", 6),
        ("light_cycles", 2.5),
        ("ambient", -0.1),
        ("ambient", float("nan")),
        ("ambient", 30.0),
        ("sd_ambient", -1.0),
        ("sd_light_phase_rad", float("nan")),
        ("light_rise_s", -1e-4),
        ("light_rise_s", 0.2),
    ],
)
def test_bad_values_are_refused(key: str, value: object) -> None:
    with pytest.raises(ValidationError) as refused:
        CaptureFile.model_validate({**CODE, key: value})
    assert key.split("_", maxsplit=1)[0] in str(refused.value) or "rise" in str(refused.value)


@pytest.mark.parametrize("key", ["light_phase_rad", "light_cycles", "light_rise_s", "sd_light_phase_rad", "sd_ambient"])
def test_keys_of_the_lamp_without_a_code_are_refused_by_name(key: str) -> None:
    with pytest.raises(ValidationError, match=key):
        CaptureFile.model_validate({"frequency_hz": 5.0, "exposure_s": 1.0, key: 1})


def test_a_code_may_be_written_as_campaigns_name_it() -> None:
    named = CaptureFile.model_validate({**CODE, "light": "1110100"})
    assert named.light_code() == CaptureFile.model_validate(CODE).light_code()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("light_phase = 0.2", "light_phase: unknown key; did you mean light_phase_rad?"),
        ("phase = 0.2", "phase: unknown key; did you mean phase_rad?"),
        ("light_cycles = 6", "capture.toml: light_cycles = 6 do not fit into an exposure of 5 excitation cycles"),
    ],
)
def test_a_capture_file_is_refused_in_words_that_help(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "capture.toml"
    path.write_text(f"frequency_hz = 5.0\nexposure_s = 1.0\nlight = [1, 1, 1, 0, 1, 0, 0]\n{text}\n")
    with pytest.raises(ConfigError) as refused:
        _read_capture(path, ("left",))
    assert said in str(refused.value)


def test_a_code_of_unknown_phase_is_said(tmp_path: Path) -> None:
    code = "frequency_hz = 5.0\nexposure_s = 1.0\nlight = [1, 1, 1, 0, 1, 0, 0]\n"
    for name, text in (("c1", code), ("c2", f"{code}light_phase_rad = 0.0\n"), ("c3", "frequency_hz = 5.0\n")):
        (tmp_path / "captures" / name).mkdir(parents=True)
        (tmp_path / "captures" / name / "left.dng").touch()
        (tmp_path / "captures" / name / "capture.toml").write_text(text)
    folder = DataFolder(tmp_path, SimpleNamespace(cameras={"left": None}), (), ())
    (note,) = _unknown_phases(folder, ("c1", "c2", "c3"))
    assert note.startswith("c1: capture.toml has light, but no light_phase_rad")
