from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError
from labdaemon.processing.rigfile import read_rig

GOOD = """
[cameras.left]
image_size = [3872, 2592]
focal_px = [3937.7, 3937.7]
principal_point_px = [1942.8, 1283.7]
distortion = [-0.09, 0.07, 0.0003, -0.0002, 0.0]
[targets]
diameter_mm = 8.0
[control]
family = "apriltag-36h11"
size_mm = 36.0
"""


def rig(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return path


def test_reads_the_contract_s_example(tmp_path: Path) -> None:
    read = read_rig(rig(tmp_path, GOOD))
    assert read.cameras["left"].image_size == (3872, 2592)
    assert read.cameras["left"].distortion[2] == 0.0003
    assert read.targets.diameter_mm == (8.0,)
    assert read.processing.method == "fit"


def test_several_sizes(tmp_path: Path) -> None:
    assert read_rig(rig(tmp_path, GOOD.replace("= 8.0", "= [5, 8.0, 12]"))).targets.diameter_mm == (5.0, 8.0, 12.0)


def test_a_daemon_s_own_sections_and_keys_are_left_alone(tmp_path: Path) -> None:
    more = GOOD.replace("[cameras.left]", '[cameras.left]\ndriver = "ptp"\nserial = "301"\nsd_focal_px = [1.0, 1.0]')
    more += '\n[shaker]\ndriver = "scpi"\n[service]\ndata = "x"\n'
    assert list(read_rig(rig(tmp_path, more)).cameras) == ["left"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("focal_px", "focal_pix", r"cameras\.left\.focal_pix.*did you mean focal_px"),
        ("diameter_mm", "diametre_mm", r"targets\.diametre_mm.*did you mean diameter_mm"),
        ("[targets]", "[target]", r"target: unknown key; did you mean targets"),
        ("focal_px = [3937.7, 3937.7]", "", r"cameras\.left: no focal_px.*labdaemon calibrate camera"),
        ("= 8.0", "= 0.008", r"diameter_mm: 0.008 mm looks like metres"),
        ("= 36.0", "= 0.036", r"size_mm: 0.036 mm looks like metres"),
        ("[3872, 2592]", "[3872]", r"cameras\.left\.image_size"),
        ("3937.7, 3937.7", "-1, 1", r"cameras\.left\.focal_px"),
        ("-0.09, 0.07", "nan, 0.07", r"cameras\.left\.distortion"),
        ("[control]", "[control", r"is not valid TOML"),
        ('family = "apriltag-36h11"', "", r"control\.family"),
    ],
)
def test_says_what_is_wrong_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = rig(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(ConfigError, match=said) as caught:
        read_rig(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"rig\.toml: file is missing"):
        read_rig(tmp_path / "rig.toml")
