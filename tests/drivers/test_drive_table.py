"""Drive level to millimetres: through the points, between them, and never beyond."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import ConfigError, LimitError
from labdrivers.drive_table import DrivePoint, DriveTable, read_drive_csv


def table(*points: tuple[float, float]) -> DriveTable:
    return DriveTable([DrivePoint(frequency_hz=hz, mm_per_v=mm) for hz, mm in points], key="shaker.drive")


POINTS = ((5.0, 8.0), (10.0, 2.0), (20.0, 0.5))


def test_points_are_met_in_any_order() -> None:
    for ordered in (POINTS, POINTS[::-1]):
        for hz, mm in POINTS:
            assert table(*ordered).mm_per_v(hz) == pytest.approx(mm)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(5.0, 20.0))
def test_a_constant_force_falls_with_the_square_of_the_frequency(hz: float) -> None:
    """Straight in log-log: a power law between the points is met exactly."""
    assert table(*POINTS).mm_per_v(hz) == pytest.approx(8.0 * (5.0 / hz) ** 2)


@pytest.mark.parametrize("hz", [4.99, 20.01, 0.1, 1000.0])
def test_nothing_is_extrapolated(hz: float) -> None:
    """A resonance of the table may lie there."""
    with pytest.raises(LimitError, match="calibrated from 5 to 20 Hz") as caught:
        table(*POINTS).mm_per_v(hz)
    assert caught.value.key == "shaker.drive"


def test_a_single_point_holds_at_its_own_frequency() -> None:
    assert table((5.0, 8.0)).mm_per_v(5.0) == pytest.approx(8.0)
    with pytest.raises(LimitError):
        table((5.0, 8.0)).mm_per_v(5.1)


def test_no_point_or_two_at_one_frequency_are_mistakes() -> None:
    with pytest.raises(ConfigError, match="empty"):
        table()
    with pytest.raises(ConfigError, match="two drive points at one frequency"):
        table((5.0, 8.0), (5.0, 7.0))


def test_a_calibration_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    file.write_text("frequency_hz,mm_per_v,note\n5,8,measured by laser\n10,2,\n")
    assert [(point.frequency_hz, point.mm_per_v) for point in read_drive_csv(file)] == [(5.0, 8.0), (10.0, 2.0)]


@pytest.mark.parametrize(("text", "words"), [
    ("frequency_hz,mm_per_v\n5,8\n10,zero\n", "line 3"),
    ("frequency_hz,mm_per_v\n-5,8\n", "line 2"),
    ("frequency_hz,mm_per_v\n5\n", "line 2"),
    ("hz,mm\n5,8\n", "line 2"),
])  # fmt: skip
def test_a_line_that_is_no_point_is_named(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "drive.csv"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_drive_csv(file)


def test_a_file_that_is_not_there_or_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"drive\.csv"):
        read_drive_csv(tmp_path / "drive.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_drive_csv(tmp_path / "binary.csv")
