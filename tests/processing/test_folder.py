from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError, DataError, LabdaemonError
from labdaemon.processing.folder import open_folder

RIG = """
[cameras.left]
image_size = [64, 48]
focal_px = [60, 60]
principal_point_px = [32, 24]
[cameras.cam-2]
image_size = [64, 48]
focal_px = [60, 60]
principal_point_px = [32, 24]
[targets]
diameter_mm = 8
[control]
family = "apriltag-36h11"
size_mm = 36
"""
CONTROL = "name,x_mm,y_mm,z_mm,sd_mm\n0,0,0,0,0.1\n1,500,0,0,0.1\n2,0,0,500,0.1\n3,500,100,500,0.1\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "control.csv").write_text(CONTROL)
    for name in ("left.dng", "left-2.dng", "left-10.NEF", "cam-2.dng", "cam-2-2.dng", "set.toml"):
        (tmp_path / "sharp").mkdir(exist_ok=True)
        (tmp_path / "sharp" / name).write_bytes(b"")
    later = tmp_path / "sharp" / "later"
    later.mkdir()
    for name in ("left.dng", "cam-2.dng"):
        (later / name).write_bytes(b"")
    (later / "set.toml").write_text("at_rest = false\n")
    for capture in ("c1", "c2"):
        where = tmp_path / "captures" / capture
        where.mkdir(parents=True)
        for name in ("left.NEF", "left.JPG", "cam-2.dng", "notes.txt"):
            (where / name).write_bytes(b"")
    return tmp_path


def test_finds_sets_frames_and_captures(folder: Path) -> None:
    opened = open_folder(folder)
    flat = opened.sharp()
    assert [p.name for p in flat.frames["left"]] == ["left.dng", "left-2.dng", "left-10.NEF"]
    assert [p.name for p in flat.frames["cam-2"]] == ["cam-2.dng", "cam-2-2.dng"]
    assert flat.at_rest
    assert flat.name == ""
    assert not opened.sharp("later").at_rest
    assert opened.capture_names() == ("c1", "c2")
    assert opened.capture("c1").frames["left"].name == "left.NEF"
    assert opened.capture("c1").about.window("left") is None


def test_reads_what_is_known_of_an_exposure(folder: Path) -> None:
    (folder / "captures/c1/capture.toml").write_text(
        'frequency_hz = 5.5\nexposure_s = 1.0\nphase_rad = 0.5\nsd_phase_rad = 0.01\ngroup = "g"\nsharp = "later"\n'
        'opened_at = "2026-05-04T10:11:12Z"\n[cameras.cam-2]\nphase_rad = 0.6\n'
    )
    about = open_folder(folder).capture("c1").about
    left, right = about.window("left"), about.window("cam-2")
    assert left is not None
    assert right is not None
    assert (left.cycles, left.phase_rad, left.sd_phase_rad) == (5.5, 0.5, 0.01)
    assert right.phase_rad == 0.6
    assert (about.group, about.sharp) == ("g", "later")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: (f / "captures/c1/left.NEF").unlink(), r"c1/left\.JPG: a JPEG"),
        (lambda f: [(f / "captures/c1" / n).unlink() for n in ("left.NEF", "left.JPG")], "c1: no frame of camera left"),
        (lambda f: (f / "captures/c1/left.png").write_bytes(b""), r"left\.png: a second frame of camera left"),
        (lambda f: (f / "captures/c1/right.dng").write_bytes(b""), r"right\.dng: belongs to no camera"),
        (lambda f: (f / "captures/c1/left-2.dng").write_bytes(b""), r"left-2\.dng: belongs to no camera"),
        (lambda f: (f / "captures/c1/capture.toml").write_text("frequency = 5\n"), "did you mean frequency_hz"),
        (lambda f: (f / "captures/c1/capture.toml").write_text("exposure_s = 0\n"), r"capture\.toml: exposure_s"),
        (lambda f: (f / "captures/c1/capture.toml").write_text('group = "a/b"\n'), "cannot be a name"),
        (lambda f: (f / "captures/c1/capture.toml").write_text("[cameras.top]\n"), "no camera of rig"),
        (lambda f: (f / "captures/c1/capture.toml").write_text("x = \n"), "is not valid TOML"),
    ],
)
def test_a_bad_capture_is_refused_by_file(folder: Path, change: object, said: str) -> None:
    assert callable(change)
    change(folder)
    with pytest.raises(LabdaemonError, match=said) as caught:
        open_folder(folder).capture("c1")
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)


def test_a_bad_sharp_set_is_refused(folder: Path) -> None:
    opened = open_folder(folder)
    with pytest.raises(DataError, match="missing"):
        opened.sharp("never")
    with pytest.raises(DataError, match="cannot name"):
        opened.sharp("../captures")
    (folder / "sharp/later/left.dng").unlink()
    with pytest.raises(DataError, match="no sharp frame of camera left"):
        opened.sharp("later")
    for path in (folder / "sharp").glob("*.*"):
        path.unlink()
    with pytest.raises(DataError, match=r"name one of its sets \(later\)"):
        opened.sharp()
    (folder / "sharp/later/set.toml").write_text("at_rest = 1\n")
    (folder / "sharp/later/left.dng").write_bytes(b"")
    with pytest.raises(ConfigError, match="true or false"):
        opened.sharp("later")


def test_a_bad_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="not a folder"):
        open_folder(tmp_path / "nowhere")
    (folder / "rig.toml").write_text(RIG.replace("apriltag-36h11", "qr-codes"))
    with pytest.raises(ConfigError, match=r"control\.family.*'qr-codes'"):
        open_folder(folder)


def test_gauges_of_a_capture_are_read_by_name(folder: Path) -> None:
    (folder / "captures/c1/capture.toml").write_text(
        "[gauges]\nnote = 3\n[gauges.table]\nunit = 'mm'\namplitude_mm = 2.0\nh3_mm = 0.1\nnew_in_some_version = 1\n"
    )
    [one] = open_folder(folder).gauges("c1")
    assert (one.gauge, one.amplitude_mm, one.h3_mm, one.phase_rad) == ("table", 2.0, 0.1, None)
    (folder / "captures/c1/capture.toml").write_text("gauges = 'none'\n")
    assert open_folder(folder).gauges("c1") == ()
    for wrong in ("amplitude_mm = 'two'", "amplitude_mm = -2.0", "h3_mm = nan", "sd_h3_mm = inf", "frequency_hz = 8.0"):
        (folder / "captures/c1/capture.toml").write_text(f"frequency_hz = 5.0\n[gauges.table]\n{wrong}\n")
        with pytest.raises(ConfigError, match=rf"c1/capture\.toml: .*gauges\.table\.{wrong.split()[0]}"):
            open_folder(folder).gauges("c1")
