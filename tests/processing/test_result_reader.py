"""Result files that came back from a spreadsheet, a script or a full disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.motion import ObjectMotion
from labdaemon.processing.result_reader import read_csv
from labdaemon.processing.tables import ENVELOPE_COLUMNS, csv_text, envelope_row

MOTION = ObjectMotion(np.array([100.0, 0.0, 50.0]), np.array([1.5, 0.0, -0.25]), np.zeros(3), np.eye(9) * 1e-4, None)
ROWS = [envelope_row("c1", name, MOTION, []) for name in ("T01", "T02")]
TEXT = csv_text(ENVELOPE_COLUMNS, ROWS)


def written(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "envelope.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def semicolons(text: str) -> str:
    """As a spreadsheet of a country with decimal commas saves it."""
    return text.replace(",", ";").replace(".", ",")


def with_column(text: str) -> str:
    lines = text.splitlines()
    return "\n".join([f"{lines[0]},remark", *(f"{line},near the joint" for line in lines[1:])])


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,  # a spreadsheet's byte order mark
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text + "\n\n",
        with_column,
    ],
    ids=["byte order mark", "line ends", "empty lines", "a column more"],
)
def test_what_does_no_harm_is_read(tmp_path: Path, change: Callable[[str], str]) -> None:
    rows = read_csv(written(tmp_path, change(TEXT)))
    assert [{name: row[name] for name in ROWS[0]} for row in rows] == ROWS


def test_not_a_number_is_empty(tmp_path: Path) -> None:
    assert read_csv(written(tmp_path, TEXT.replace("1.500000", "nan")))[0]["ax_mm"] is None
    assert read_csv(written(tmp_path, "")) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (semicolons, "has ';' between its columns"),
        (lambda text: text.replace(",", "\t"), "has tabs between its columns"),
        (lambda text: "Time,Ch1,Ch2\n0.0,1.0,2.0\n", "its columns are Time, Ch1, Ch2"),
        (lambda text: "capture,target,amplitude\nc1,T01,2.0\n", "lacks the columns x_mm, y_mm, z_mm, ax_mm and 16"),
        (lambda text: text.replace("ay_mm", "ax_mm", 1).replace("residual_ratio", "ay_mm"), "lacks the columns resid"),
        (lambda text: text.replace("cor_x_y", "ax_mm", 1), "has the column ax_mm twice"),
        (lambda text: text[:-60], r"line 3 has \d+ values where the header has 41"),
        (lambda text: text.replace("\nc1", "\n7,c1"), "line 2 has 42 values"),
        (lambda text: text[:500] + "\0" * 40, "line 2 has"),
        (lambda text: text.replace("1.500000", "1.5 mm"), "line 2, ax_mm: '1.5 mm' is no number"),
        (lambda text: text.replace("1.500000", "inf"), "line 2, ax_mm: inf is no result"),
        (lambda text: text.replace("1.500000", "1e300"), "line 2, ax_mm: 1e300 is no result"),
        (lambda text: text.replace("0.010000", "-0.010000", 1), "line 2, sd_x_mm: -0.010000 is no standard deviation"),
        (lambda text: text.replace(",,,,", ",,0.01,,", 1), "line 2: '0.01' is no flag"),
        (lambda text: text + text.splitlines()[1], "has capture c1, target T01 twice"),
        (lambda text: text.replace("T02", '"T02'), "is no line of a table"),
        (lambda text: text.encode("utf-16"), "is not UTF-8 text"),
    ],
)
def test_another_form_is_refused_with_its_place(
    tmp_path: Path, change: Callable[[str], str | bytes], said: str
) -> None:
    path = written(tmp_path, change(TEXT))
    with pytest.raises(DataError, match=said) as caught:
        read_csv(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).endswith("`labdaemon process` writes it anew")
    assert "\n" not in str(caught.value)


def test_a_folder_in_its_place_is_said(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        read_csv(tmp_path)
