from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry import ImageMotion, compensate_camera_motion, fit_plane, map_motion_to_plane
from labdaemon.geometry.harmonic import project_motion

NAMES = list("abcdefgh")
ALONG_MM = np.array([350.0, 340.0, -350.0, -345.0, 330.0, -350.0, 100.0, 0.0])
HEIGHT_MM = np.array([130.0, 600.0, 135.0, 590.0, 370.0, 380.0, 100.0, 650.0])


def board(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Control on a vertical plane through the origin at an angle in plan, and the unit vector along it."""
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    return ALONG_MM[:, None] * along + HEIGHT_MM[:, None] * np.array([0.0, 0.0, 1.0]), along


def in_front(look, angle: float):
    """A camera a metre away, 20° off the plane's normal."""
    return look(np.array([np.sin(angle - 0.35), -np.cos(angle - 0.35), 0.0]) * 1000 + [0, 0, 400], roll=0.03)


def image(camera, mean, a, b, sd: float = 1e-3, phased: bool = True) -> ImageMotion:
    numbers = project_motion(camera.project_with_jacobians, np.stack([mean, a, b]))[0]
    return ImageMotion(numbers[:2], numbers[2:4], numbers[4:], np.eye(6) * sd**2, phased)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(angle=st.floats(-1.6, 1.6), size=st.floats(0.1, 15.0), tilt=st.floats(-3.1, 3.1))
def test_exact_numbers_come_back_exactly(look, angle: float, size: float, tilt: float) -> None:
    """Any attitude in plan, large amplitudes near the frame's edge: distortion and perspective cost nothing."""
    control, along = board(angle)
    camera = in_front(look, angle)
    plane = fit_plane(camera.lens, camera.project(control), control, names=NAMES)
    mean = along * 300 + np.array([0.0, 0.0, 560.0])
    a = size * (np.cos(tilt) * along + np.sin(tilt) * np.array([0.0, 0.0, 1.0]))
    b = 0.3 * size * along
    motion = map_motion_to_plane(plane, image(camera, mean, a, b))
    np.testing.assert_allclose(motion.mean_mm, mean, atol=1e-5)
    np.testing.assert_allclose(motion.a_mm, a, atol=1e-5)
    np.testing.assert_allclose(motion.b_mm, b, atol=1e-5)
    assert abs(motion.a_mm @ plane.normal) < 1e-9


def test_a_camera_that_turned_turns_no_vector(look) -> None:
    """A frame shifted and turned by a quarter of a degree: mean, a and b are still those of the plane."""
    angle = 0.3
    control, along = board(angle)
    camera = in_front(look, angle)
    plane = fit_plane(camera.lens, camera.project(control), control, names=NAMES)
    moved = [camera.apply_change(np.array([1e-3, -2e-3, 0.0044 * k, 0.3, 0.0, -0.2])) for k in (1, 2)]
    mean, up = along * 200 + np.array([0.0, 0.0, 500.0]), np.array([0.0, 0.0, 1.0])
    a, b = 4.0 * along + 3.0 * up, 0.8 * along - 0.5 * up
    seen = image(moved[0], mean, a, b)
    assert np.linalg.norm(map_motion_to_plane(plane, seen).a_mm - a) > 0.01
    motion = map_motion_to_plane(plane, compensate_camera_motion(plane, seen, camera, moved[:1]))
    np.testing.assert_allclose(motion.mean_mm, mean, atol=2e-4)
    np.testing.assert_allclose(motion.a_mm, a, atol=2e-5)
    np.testing.assert_allclose(motion.b_mm, b, atol=2e-5)
    both = [image(one, mean, a, b) for one in moved]
    between = (np.mean([getattr(one, name) for one in both], axis=0) for name in ("mean_px", "a_px", "b_px"))
    joined = map_motion_to_plane(
        plane, compensate_camera_motion(plane, ImageMotion(*between, np.eye(6), True), camera, moved)
    )
    np.testing.assert_allclose(joined.a_mm, a, atol=2e-4)


def test_the_papers_regression(look) -> None:
    """Trace, intercept's foot and plane coordinates, computed independently."""
    rng = np.random.default_rng(4)
    control, _ = board(0.3)
    control = control + np.array([12.0, -40.0, 0.0])
    surveyed = control + rng.normal(0, 0.2, control.shape)
    camera = in_front(look, 0.3)
    plane = fit_plane(camera.lens, camera.project(control), surveyed, names=NAMES, sd_object_mm=0.3)
    gradient, intercept = np.polyfit(surveyed[:, 0], surveyed[:, 1], 1)
    np.testing.assert_allclose(plane.origin_mm, [0.0, intercept, 0.0], atol=1e-9)
    np.testing.assert_allclose(plane.axes[:, 0], np.array([1.0, gradient, 0.0]) / np.hypot(1, gradient), atol=1e-12)
    assert plane.off_plane_mm is not None
    expected = (surveyed[:, 1] - gradient * surveyed[:, 0] - intercept) / np.hypot(1, gradient)
    np.testing.assert_allclose(plane.off_plane_mm, expected, atol=1e-9)


def test_an_unphased_ellipse_is_reported_by_its_axes(look) -> None:
    """Seen obliquely the axes of an image are not the orbit's: they are found again in the plane."""
    angle = 0.2
    control, along = board(angle)
    camera = look(np.array([700.0, -700.0, 500.0]))
    plane = fit_plane(camera.lens, camera.project(control), control, names=NAMES)
    mean, up = along * 50 + np.array([0.0, 0.0, 300.0]), np.array([0.0, 0.0, 1.0])
    a, b = 4.0 * along + 1.0 * up, -0.5 * along + 2.0 * up
    a, b = a * np.cos(0.7) + b * np.sin(0.7), b * np.cos(0.7) - a * np.sin(0.7)
    seen = image(camera, mean, a, b, phased=False)
    turn = 0.5 * np.arctan2(2 * seen.a_px @ seen.b_px, seen.a_px @ seen.a_px - seen.b_px @ seen.b_px)
    major = seen.a_px * np.cos(turn) + seen.b_px * np.sin(turn)
    minor = seen.b_px * np.cos(turn) - seen.a_px * np.sin(turn)
    motion = map_motion_to_plane(plane, ImageMotion(seen.mean_px, -major, minor, seen.covariance_px2))
    assert motion.a_mm @ motion.b_mm == pytest.approx(0.0, abs=1e-6)
    moment = np.outer(a, a) + np.outer(b, b)
    found = np.outer(motion.a_mm, motion.a_mm) + np.outer(motion.b_mm, motion.b_mm)
    np.testing.assert_allclose(found, moment, atol=1e-5)
    assert motion.a_mm[np.argmax(np.abs(motion.a_mm))] > 0


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2])
def test_stated_uncertainty_is_true(look, angle: float) -> None:
    rng = np.random.default_rng(8)
    control, along = board(angle)
    camera = in_front(look, angle)
    pulls = []
    for _ in range(30):
        pixels = camera.project(control) + rng.normal(0, 0.05, (8, 2))
        surveyed = control + rng.normal(0, 0.3, control.shape)
        plane = fit_plane(camera.lens, pixels, surveyed, names=NAMES, sd_image_px=0.05, sd_object_mm=0.3)
        mean = along * rng.uniform(-250, 250) + np.array([0.0, 0.0, rng.uniform(200, 500)])
        a = 3.0 * along + np.array([0.0, 0.0, 1.0])
        seen = image(camera, mean, a, 0 * a)
        noisy = ImageMotion(
            seen.mean_px + rng.normal(0, 0.01, 2), seen.a_px + rng.normal(0, 0.01, 2), seen.b_px, np.eye(6) * 1e-4
        )
        motion = map_motion_to_plane(plane, noisy)
        sd = np.sqrt(np.diag(motion.covariance_mm2))
        seen_axes = np.argsort(np.abs(plane.normal))[:2]
        assert np.isnan(sd[np.argmax(np.abs(plane.normal))])
        a_signed = a * np.sign(a[np.argmax(np.abs(a))])
        pulls.append([*((motion.mean_mm - mean) / sd[:3])[seen_axes], *((motion.a_mm - a_signed) / sd[3:6])[seen_axes]])
    spread = np.std(pulls, axis=0)
    assert np.all((spread > 0.65) & (spread < 1.4)), spread


def test_control_off_the_plane_is_refused_with_its_residuals(look) -> None:
    control, _ = board(0.0)
    camera = in_front(look, 0.0)
    control[2, 1] += 20.0
    with pytest.raises(DataError, match=r"not lie in one vertical plane.*c \+1\d\.\d\d") as caught:
        fit_plane(camera.lens, camera.project(control), control, names=NAMES, sd_object_mm=0.3)
    assert "\n" not in str(caught.value)


def test_a_level_plane_is_refused(look) -> None:
    level = np.column_stack([ALONG_MM, HEIGHT_MM, np.full(8, 100.0)])
    camera = look((0, -800, 1500), at=(0, 300, 100))
    with pytest.raises(DataError, match="vertical plane"):
        fit_plane(camera.lens, camera.project(level), level, names=NAMES, sd_object_mm=0.3)


def test_a_point_misread_in_the_frame_is_left_out(look) -> None:
    control, _ = board(0.0)
    camera = in_front(look, 0.0)
    pixels = camera.project(control) + np.random.default_rng(1).normal(0, 0.03, (8, 2))
    pixels[5] += [8.0, -6.0]
    plane = fit_plane(camera.lens, pixels, control, names=NAMES, sd_image_px=0.03)
    assert plane.excluded is not None
    assert list(plane.excluded) == ["f"]


def test_bad_control_is_refused(look) -> None:
    control, along = board(0.0)
    camera = in_front(look, 0.0)
    with pytest.raises(DataError, match="at least 4"):
        fit_plane(camera.lens, camera.project(control[:3]), control[:3], names=NAMES[:3])
    with pytest.raises(DataError, match="metres"):
        fit_plane(camera.lens, camera.project(control), control / 1000, names=NAMES)
    line = along * np.linspace(-300, 300, 8)[:, None] + np.array([0.0, 0.0, 300.0])
    with pytest.raises(DataError, match="line"):
        fit_plane(camera.lens, camera.project(line), line, names=NAMES)
    with pytest.raises(DataError, match=r"do not fit together|no projective"):
        fit_plane(
            camera.lens, camera.project(control)[[3, 0, 6, 1, 7, 2, 4, 5]], control, names=NAMES, sd_object_mm=0.3
        )


def test_a_target_that_was_not_measured_stays_without_numbers(look) -> None:
    control, _ = board(0.0)
    camera = in_front(look, 0.0)
    plane = fit_plane(camera.lens, camera.project(control), control, names=NAMES)
    nothing = np.full(2, np.nan)
    motion = map_motion_to_plane(plane, ImageMotion(nothing, nothing, nothing, np.full((6, 6), np.nan)))
    assert np.isnan(motion.a_mm).all()
    assert np.isnan(motion.covariance_mm2).all()
