from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.photomodeler_export import read_photomodeler, rotation_from_angles


def test_reads_camcal(shared_data: Path) -> None:
    project = read_photomodeler((shared_data / "camcal/camcal-pmexport.txt").read_text())
    assert project.lens.image_size == (2272, 1704)
    assert project.lens.camera_constant_mm == pytest.approx(7.4653)
    assert len(project.files) == len(project.poses) == 21
    assert project.files[0] == "P8250021.JPG"
    assert len(project.points) == 100
    assert project.image_px.shape == (2074, 2)
    # First pixel of the export: its top-left pixel's centre is (0.5, 0.5), ours (0, 0).
    np.testing.assert_allclose(project.image_px[0], [1428.6871, 1455.9278])
    assert project.point_ids[project.point[0]] == 2


def test_angles_turn_the_way_photogrammetry_does() -> None:
    """A camera looking straight down sees X to the right and Y up; kappa turns it about its axis."""
    down = rotation_from_angles(0.0, 0.0, 0.0)
    np.testing.assert_allclose(down @ [1, 2, -3], [1, -2, 3])
    turned = rotation_from_angles(0.0, 0.0, np.pi / 2)
    np.testing.assert_allclose(turned @ [0, 1, 0], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("text", ["", "a\nb\n", "a\n 1 2 3 x y\n\n1\n"])
def test_another_file_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="not a PhotoModeler text export"):
        read_photomodeler(text)
