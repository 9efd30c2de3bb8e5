"""The bench of real frames: dots of a drawn sheet instead, moved by known amounts, so that it needs no data."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.bench.real import CAUSES, command, peak_to_peak_excess, read_tracked
from labdaemon.errors import DataError

TRUTH = "target,floor,rest_x_px,rest_y_px,centre_x_px,centre_y_px,semi_amplitude_px,direction_deg"


def draw(moves: list[float]) -> np.ndarray:
    """A 16-bit sheet of dots, drawn eight times finer; each moved by its own amplitude along x."""
    fine = np.full((8 * 80, 8 * 80 * len(moves)), 50_000.0)
    y, x = np.mgrid[: fine.shape[0], : fine.shape[1]]
    for k, move in enumerate(moves):
        places = np.sin(2 * np.pi * (np.arange(32) + 0.5) / 32) * move if move else [0.0]
        ink = [(np.hypot(x - 8 * (80 * k + 40 + dx), y - 8 * 40) < 8 * 10.5) for dx in places]
        fine -= 44_000 * np.mean(ink, axis=0)
    fine = cv2.GaussianBlur(fine, (0, 0), 8.0)
    image = cv2.resize(fine, None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(image + np.random.default_rng(1).normal(0, 60, image.shape)), np.uint16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("real")
    moves = [1.5, 2.5, 2.0]
    cv2.imwrite(str(where / "sharp.png"), draw([0.0] * 3))
    cv2.imwrite(str(where / "blurred.png"), draw(moves))
    rows = [f"{k},1,{80 * k + 40},40,{80 * k + 40},40,{a},0" for k, a in enumerate(moves)]
    (where / "truth.csv").write_text("\n".join([TRUTH, *rows]) + "\n")
    return where


def test_one_line_a_cause_with_errors_and_pulls(folder: Path) -> None:
    words = [str(folder), "--groups", "1", "--amplitude", "1.5", "--cause", "1", "--cause", "3"]
    ran = CliRunner().invoke(command, words)
    assert ran.exit_code == 0, ran.output
    lines = [line for line in ran.output.splitlines() if line.startswith(("the frame as blurred, all", "1.5 px,"))]
    blurred, plain, one_sided = ([float(word) for word in line.split()[-5:]] for line in lines)
    assert blurred[:2] == plain[:2] == [3, 0]
    assert abs(blurred[2]) < 0.02
    assert abs(plain[2]) < 0.01
    assert one_sided[2] < plain[2] - 0.01, "more blur across than along the motion reads as less motion"


def test_half_a_noisy_track_s_peak_to_peak_is_too_long() -> None:
    noisy, long = peak_to_peak_excess(1.5, 0.035, 200), peak_to_peak_excess(1.5, 0.035, 1000)
    assert 0.03 < noisy < long
    assert abs(peak_to_peak_excess(1.5, 1e-6, 1000)) < 1e-3


def test_each_cause_differs_from_the_first() -> None:
    assert len({cause.name for cause in CAUSES}) == len(CAUSES)


@pytest.mark.parametrize("content", [None, "a,b\n1,2\n"])
def test_a_folder_without_tracked_dots_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "truth.csv").write_text(content)
    with pytest.raises(DataError, match="tracked dots"):
        read_tracked(tmp_path / "truth.csv")
