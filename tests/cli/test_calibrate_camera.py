from __future__ import annotations

import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.cli.calibrate import calibrate
from labdaemon.cli.calibrate_camera import camera_table
from labdaemon.errors import DataError, UsageError
from labdaemon.geometry.lens import Lens
from labdaemon.processing.calibration import CameraCalibration
from labdaemon.report.residuals import draw_residuals

RESULT = CameraCalibration(
    Lens((3872, 2592), (3937.7, 3938.1), (1942.8, 1283.7), (-0.09, 0.07, 3e-4, -2e-4, 0.001)),
    np.array([0.3, 0.3, 0.4, 0.5, 1e-4, 2e-4, 3e-6, 4e-6, 5e-4]),
    0.087,
    2100,
    (Path("a.nef"), Path("b.nef")),
    np.array([[100.0, 200.0], [3000.0, 2000.0]]),
    np.array([[0.1, 0.0], [0.0, -0.1]]),
    np.array([0, 1]),
    (),
    (),
)


def run(*arguments: str):
    return CliRunner().invoke(calibrate, ["camera", *arguments], catch_exceptions=True)


def test_the_table_reads_back_and_says_how_sure_it_is() -> None:
    text = camera_table("left", RESULT)
    table = tomllib.loads(text)["cameras"]["left"]
    assert table["image_size"] == [3872, 2592]
    assert table["focal_px"] == [3937.7, 3938.1]
    assert table["distortion"] == [-0.09, 0.07, 3e-4, -2e-4, 0.001]
    assert set(table) == {"image_size", "focal_px", "principal_point_px", "distortion"}
    assert "# sd 0.3, 0.3" in text
    assert "sigma0 0.0870 px, 2100 degrees of freedom" in text


def test_the_residual_picture_shows_every_residual() -> None:
    image = draw_residuals((3872, 2592), RESULT.image_px, RESULT.residuals_px, 0.1, "left")
    assert image.shape == (60 + 938, 1400, 3)
    x, y = ((RESULT.image_px[0] + 0.5) * 1400 / 3872 + [0, 60]).astype(int)
    assert image[y, x].max() < 255
    assert image[500, 700].min() == 255


@pytest.mark.slow
def test_photographs_in_table_and_picture_out(shared_data: Path, tmp_path: Path) -> None:
    result = run(str(shared_data / "camcal/images"), "--jpeg", "--name", "olympus", "--out", str(tmp_path), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["sigma0_px"] <= 0.2
    assert len(told["photographs"]) == 21
    table = tomllib.loads((tmp_path / "olympus.toml").read_text())["cameras"]["olympus"]
    assert table["image_size"] == [2272, 1704]
    assert table["focal_px"] == pytest.approx(told["focal_px"], abs=1e-3)
    assert cv2.imread(str(tmp_path / "olympus-residuals.png")) is not None
    assert not list(tmp_path.glob("*.part"))


def test_a_photomodeler_export_is_read_and_converted(shared_data: Path, tmp_path: Path) -> None:
    """Brown's backward model in, OpenCV's out, from the export's own points."""
    result = run(str(shared_data / "camcal/camcal-pmexport.txt"), "--name", "olympus", "--out", str(tmp_path), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["sigma0_px"] < 0.16
    assert told["focal_px"][1] == pytest.approx(7.457 / (5.43764 / 1704), abs=2.0)
    assert told["sd"]["fx"] < 1.0
    broken = tmp_path / "other.txt"
    broken.write_text("nothing of the kind\n")
    refused = run(str(broken))
    assert isinstance(refused.exception, DataError)
    assert "other.txt: not a PhotoModeler text export" in str(refused.exception)


def test_bad_input_is_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    for k in range(4):
        cv2.imwrite(str(photographs / f"{k}.jpg"), np.full((60, 80), 200, np.uint8))
    for arguments, kind, text in (
        ([str(tmp_path / "no")], DataError, "no such folder"),
        ([str(photographs)], DataError, "is a JPEG"),
        ([str(photographs), "--charuco", "9"], UsageError, "as 9x6"),
        ([str(photographs), "--name", "a b"], UsageError, "cannot be a camera's name"),
    ):
        result = run(*arguments)
        assert isinstance(result.exception, kind), result.exception
        assert text in str(result.exception)
        assert "\n" not in str(result.exception)
        assert result.exception.exit_status == 2
    assert not (photographs / "results").exists()
