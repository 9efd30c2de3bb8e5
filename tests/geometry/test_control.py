"""What a set of control targets must fulfil before it is believed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry.control import check_control, check_names, check_scale, check_volume
from labdaemon.geometry.oriented_camera import OrientedCamera

NAMES = [f"C{number}" for number in range(8)]


def test_a_good_set_passes(control_mm: np.ndarray, look: Callable[..., OrientedCamera]) -> None:
    pixels = look((0.0, -900.0, 500.0)).project(control_mm)
    check_control(NAMES, pixels, control_mm)
    check_volume(control_mm, np.full(control_mm.shape, 0.05))


def test_a_name_is_for_one_place() -> None:
    check_names(["A", "B"])
    with pytest.raises(DataError, match="A, C is there more than once"):
        check_names(["A", "B", "C", "A", "C", "C"])


@pytest.mark.parametrize(("change", "words"), [
    (lambda names, pixels, mm: (names[:7], pixels, mm), "7 names, 8 pixels and 8 positions"),
    (lambda names, pixels, mm: (names[:3], pixels[:3], mm[:3]), r"3 surveyed control targets in view \(C0, C1, C2\)"),
    (lambda names, pixels, mm: ([], pixels[:0], mm[:0]), "0 surveyed control targets in view; at least 4"),
    (lambda names, pixels, mm: (names, np.where(pixels > 0, pixels, pixels) * np.nan, mm), "no number"),
    (lambda names, pixels, mm: (names, pixels, mm / 1000.0), "as if given in metres"),
    (lambda names, pixels, mm: (names, pixels, mm * [1.0, 1e-6, 1e-6]), "all lie in a line"),
])  # fmt: skip
def test_a_bad_set_is_refused_in_words(
    control_mm: np.ndarray, change: Callable[..., tuple[list[str], np.ndarray, np.ndarray]], words: str
) -> None:
    names, pixels, places = change(NAMES, np.ones((8, 2)), control_mm)
    with pytest.raises(DataError, match=words):
        check_control(names, pixels, places)


def test_points_in_a_plane_do_not_orient_a_camera_in_space(control_mm: np.ndarray) -> None:
    flat = control_mm * [1.0, 0.0, 1.0]
    with pytest.raises(DataError, match="all lie in a plane"):
        check_volume(flat, np.full(flat.shape, 0.05))


def test_a_thickness_within_the_surveys_own_uncertainty_is_none(control_mm: np.ndarray) -> None:
    thin = control_mm * [1.0, 0.2, 1.0]
    check_volume(thin, np.full(thin.shape, 0.05))
    with pytest.raises(DataError, match="all lie in a plane"):
        check_volume(thin, np.full(thin.shape, 20.0))


@pytest.mark.parametrize(("factor", "words"), [
    (0.001, "metres"), (0.01, "centimetres"), (0.1, "decimetres"), (1 / 25.4, "inches"), (1000.0, "micrometres"),
    (5.0, "targets' size is wrong"),
])  # fmt: skip
def test_a_wrong_unit_of_the_survey_is_named(
    control_mm: np.ndarray, look: Callable[..., OrientedCamera], factor: float, words: str
) -> None:
    """The targets' own size says how far away they are; the survey says it too."""
    camera = look((0.0, -900.0, 500.0))
    side_px = 20.0 * np.mean(camera.lens.focal_px) / camera.to_camera_axes(control_mm)[:, 2]
    check_scale(camera, control_mm, side_px, 20.0)
    with pytest.raises(DataError, match=words):
        check_scale(camera, control_mm, side_px * factor, 20.0)
