from __future__ import annotations

import os
from pathlib import Path

import pytest

from labdaemon.errors import DataError
from labdaemon.processing.survey import SurveyedPoint, read_control, read_targets

CONTROL = """name,x_mm,y_mm,z_mm,sd_mm
0,-349.99,0.408,130.367,0.3
1,-350.153,-0.089,599.842,0.3
2,350.171,-0.017,130.224,0.3
3,349.446,0.47,599.971,0.3
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "points.csv"
    path.write_text(text)
    return path


def test_reads_control(tmp_path: Path) -> None:
    points = read_control(write(tmp_path, CONTROL), 36.0)
    assert points[2] == SurveyedPoint("2", 350.171, -0.017, 130.224, 0.3)


def test_takes_spaces_a_byte_order_mark_and_more_columns(tmp_path: Path) -> None:
    text = "\ufeff" + CONTROL.replace(",", ", ").replace("sd_mm", "sd_mm,note").replace("0.3\n", "0.3,by hand\n")
    assert len(read_control(write(tmp_path, text), 36.0)) == 4


def metres(text: str) -> str:
    head, *rows = text.strip().split("\n")
    out = [head]
    for row in rows:
        name, *numbers = row.split(",")
        out.append(",".join([name, *(f"{float(n) / 1000:.6f}" for n in numbers)]))
    return "\n".join(out) + "\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (metres(CONTROL), "metres"),
        (CONTROL.replace("z_mm", "z"), "no column z_mm"),
        (CONTROL.replace("3,349.446", "2,349.446"), "line 5: 2 is given twice"),
        (CONTROL.replace("349.446", "x"), "line 5: 3 needs numbers"),
        (CONTROL.replace("349.446", "inf"), "not finite"),
        (CONTROL.replace("3,349.446,0.47,599.971,0.3\n", ""), "3 control targets; at least 4"),
        (CONTROL.replace("599.971,0.3", "599.971,-1"), "3: sd_mm is negative"),
        (CONTROL.replace("3,349.446,0.47,599.971", "3,-340,0.47,599.971"), "1 and 3 are .* apart"),
        ("", "no column name"),
    ],
)
def test_refuses_a_bad_survey(tmp_path: Path, text: str, said: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(DataError, match=said) as caught:
        read_control(path, 36.0)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pipe_in_its_place_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "control.csv")
    with pytest.raises(DataError, match="it is no file"):
        read_control(tmp_path / "control.csv", 36.0)


def test_targets_in_metres_are_refused_and_millimetres_taken(tmp_path: Path) -> None:
    control = read_control(write(tmp_path, CONTROL), 36.0)
    text = "name,x_mm,y_mm,z_mm\na,-120,0,190\nb,120,0,470\n"
    assert [t.name for t in read_targets(write(tmp_path, text), control)] == ["a", "b"]
    with pytest.raises(DataError, match="metres"):
        read_targets(write(tmp_path, metres(text)), control)
    with pytest.raises(DataError, match="names no targets"):
        read_targets(write(tmp_path, "name,x_mm,y_mm,z_mm\n"), control)
