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
    more = GOOD.replace("[cameras.left]", '[cameras.left]\ndriver = "ptp"\nserial = "301"\nbackend = "sim"')
    more += '\n[shaker]\ndriver = "scpi"\n[lamp]\nrise_s = 1e-4\n[service]\ndata = "x"\n'
    assert list(read_rig(rig(tmp_path, more)).cameras) == ["left"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("focal_px", "focal_pix", r"cameras\.left\.focal_pix.*did you mean focal_px"),
        ("diameter_mm", "diametre_mm", r"targets\.diametre_mm.*did you mean diameter_mm"),
        ("[targets]", "[target]", r"target: unknown key; did you mean targets"),
        ("focal_px = [3937.7, 3937.7]", "", r"cameras\.left: no focal_px.*labdaemon calibrate camera"),
        ("= 8.0", "= 0.008", r"targets\.diameter_mm: should be greater than or equal to 0.5, not 0.008"),
        ("= 36.0", "= 0.036", r"control\.size_mm: should be greater than or equal to 1, not 0.036"),
        ("= 36.0", '= "36"', r"control\.size_mm: should be a valid number, not '36'"),
        ("[3937.7, 3937.7]", "[20.0, 20.0]", r"cameras\.left\.focal_px.*greater than or equal to 50, not 20"),
        ("[targets]", "[targets]\nfoo = 3", r"targets\.foo: unknown key; known keys are diameter_mm, file"),
        ("[control]", '[control]\nfamly = "apriltag-36h11"', r"control\.famly.*did you mean family"),
        ("[control]", '[processing]\nmetod = "paper"\n[control]', r"processing\.metod.*did you mean method"),
        ("[control]", '[processing]\nmethod = "papr"\n[control]', r"processing\.method: should be 'fit' or 'paper'"),
        ("[control]", '[procesing]\nmethod = "fit"\n[control]', r"procesing: unknown key; did you mean processing"),
        ("[control]", "[interlocks]\nmin_disk_byte = 3\n[control]", r"interlocks\.min_disk_byte.*min_disk_bytes"),
        ("[control]", "[service]\nevent = 3\n[control]", r"service\.event: unknown key; did you mean events"),
        ("[control]", "[shaker]\nprt = 3\n[control]", r"shaker\.prt: unknown key; did you mean port"),
        ("[control]", "[shaker.limits]\nstrok_mm = 3\n[control]", r"shaker\.limits\.strok_mm.*stroke_mm"),
        ("[control]", '[[gauge]]\ndriver = "line"\nrole = "tabel"\n[control]', r"gauge\[0\]\.role: should be 'table'"),
        ("[control]", "[lamp]\nambiant = 0.1\n[control]", r"lamp\.ambiant: unknown key; did you mean ambient"),
        ("[control]", "[lamp]\nlevels = 1\n[control]", r"lamp\.levels: should be greater than or equal to 2, not 1"),
        ("image_size =", "colour = 1\nimage_size =", r"cameras\.left\.colour: unknown key; known keys are"),
        ("image_size =", 'driver = "ptp"\nf_numbr = 8.0\nimage_size =', r"cameras\.left\.f_numbr.*f_number"),
        ("[3872, 2592]", "[3872]", r"cameras\.left\.image_size"),
        ("3937.7, 3937.7", "-1, 1", r"cameras\.left\.focal_px"),
        ("-0.09, 0.07", "nan, 0.07", r"cameras\.left\.distortion"),
        ("[control]", "[control", r"is not valid TOML"),
        ("size_mm = 36.0", "", r"control\.size_mm: is missing"),
        ("image_size = [3872, 2592]", "", r"cameras\.left.*image_size"),
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
