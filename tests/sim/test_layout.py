"""Measuring set-ups for rendered folders: everything fits, is seen, and has names of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from labdrivers.sim.layout import CAMERA_NAMES, SIZES, SceneLayout, make_layout
from labdrivers.sim.spec import frame_targets


def layout(**changes: Any) -> SceneLayout:
    options: dict[str, Any] = {
        "seed": 1, "cameras": 2, "size": "small", "targets": 18, "diameters_mm": (5.0, 8.0), "paper_mm": 40.0,
        "texture": 0.0, "texture_length_mm": 0.3, "still_paper": False, "gradient": (0.0, 0.0), "distance_mm": 1000.0,
    }  # fmt: skip
    return make_layout(**options | changes)


@pytest.mark.parametrize("cameras", CAMERA_NAMES)
@pytest.mark.parametrize("size", SIZES)
def test_every_camera_sees_every_target(cameras: int, size: str) -> None:
    made = layout(cameras=cameras, size=size)
    places = np.array([target.centre_mm for target in made.scene.targets])
    assert tuple(made.cameras) == CAMERA_NAMES[cameras]
    for camera in made.cameras.values():
        pixels = camera.project(places)
        width, height = SIZES[size][0]
        assert np.all((pixels > 20) & (pixels < np.array([width, height]) - 20))


def test_one_camera_looks_at_a_plane_and_more_at_depth() -> None:
    flat = np.array([target.centre_mm for target in layout(cameras=1).scene.targets])
    deep = np.array([target.centre_mm for target in layout(cameras=3).scene.targets])
    assert np.ptp(flat[:, 1]) == 0.0
    assert np.ptp(deep[:, 1]) > 20.0


def test_names_are_unique_and_diameters_taken_in_turn() -> None:
    targets = layout(targets=30, paper_mm=30.0).scene.targets
    assert len({target.name for target in targets}) == 30
    assert [target.diameter_mm for target in targets[:4]] == [5.0, 8.0, 5.0, 8.0]


def test_a_seed_is_a_set_up() -> None:
    one, same, other = layout(seed=5), layout(seed=5), layout(seed=6)
    assert one.scene.targets == same.scene.targets
    assert one.scene.targets != other.scene.targets


@pytest.mark.parametrize(("changes", "words"), [
    ({"targets": 500}, "do not fit"), ({"cameras": 4}, "cameras must be one of"),
    ({"size": "huge"}, "size must be one of"),
    ({"paper_mm": 300.0}, "fewer, or farther away"),
])  # fmt: skip
def test_what_cannot_be_placed_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        layout(**changes)


def test_the_frame_has_two_columns_of_dots_that_do_not_overlap() -> None:
    targets = frame_targets()
    assert [targets[0].name, targets[11].name, targets[12].name, targets[-1].name] == ["L01", "L12", "R01", "R12"]
    heights = np.array([target.centre_mm[2] for target in targets[:12]])
    assert np.all(np.diff(heights) > np.array([target.paper_mm[1] for target in targets[:11]]))
