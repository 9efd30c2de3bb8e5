from __future__ import annotations

import numpy as np
import pytest

from labdaemon.errors import DataError
from labdaemon.geometry import estimate_camera_motion

NAMES = [str(i) for i in range(8)]
SD = 0.02


@pytest.mark.parametrize("size_px", [0.0, 0.3, 3.0, 40.0])
def test_targets_elsewhere_follow_the_camera(look, control_mm, size_px: float) -> None:
    rng = np.random.default_rng(int(10 * size_px))
    camera = look((100, -1000, 300))
    change = np.array([1.0, -0.8, 0.6, 0.0, 0.0, 0.0]) * size_px / 5000 + np.array([0, 0, 0, 0.05, 0.02, 0.0])
    moved = camera.apply_change(change)
    still = camera.project(control_mm)
    seen = moved.project(control_mm) + rng.normal(0, SD, still.shape)
    found = estimate_camera_motion(camera, control_mm, still, seen, names=NAMES, sd_px=SD)
    targets = rng.uniform([-150, -60, 150], [150, 60, 600], (40, 3))
    assert np.abs(found.camera.project(targets) - moved.project(targets)).max() < 0.08
    assert found.moved == (size_px > 1)
    assert not found.excluded
    assert found.sigma0 < 2


def test_a_control_target_that_was_knocked_is_left_out(look, control_mm) -> None:
    rng = np.random.default_rng(1)
    camera = look((100, -1000, 300))
    still = camera.project(control_mm)
    seen = still + rng.normal(0, SD, still.shape)
    seen[6] += [4.0, 1.0]
    found = estimate_camera_motion(camera, control_mm, still, seen, names=NAMES, sd_px=SD)
    assert list(found.excluded) == ["6"]
    assert not found.moved


def test_frames_of_two_cameras_swapped_are_refused(look, control_mm) -> None:
    left, right = look((-500, -1000, 300)), look((500, -1000, 500))
    with pytest.raises(DataError, match="is the frame from this camera"):
        estimate_camera_motion(
            left, control_mm, left.project(control_mm), right.project(control_mm), names=NAMES, sd_px=SD
        )


def test_one_target_says_nothing(look, control_mm) -> None:
    camera = look((100, -1000, 300))
    still = camera.project(control_mm[:1])
    found = estimate_camera_motion(camera, control_mm[:1], still, still + 1.0, names=["0"])
    assert found.camera is camera
    assert not found.moved


def test_covariance_grows_with_the_shift_estimates(look, control_mm) -> None:
    camera = look((100, -1000, 300))
    still = camera.project(control_mm)
    tight = estimate_camera_motion(camera, control_mm, still, still, names=NAMES, sd_px=0.01)
    loose = estimate_camera_motion(camera, control_mm, still, still, names=NAMES, sd_px=0.1)
    assert np.all(np.diag(loose.camera.covariance) > np.diag(tight.camera.covariance))
