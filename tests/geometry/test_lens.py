from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.geometry.lens import Lens

SIZE = (3872, 2592)


def grid(size: tuple[int, int] = SIZE) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0, size[0] - 1, 25), np.linspace(0, size[1] - 1, 19))
    return np.column_stack([x.ravel(), y.ravel()])


def test_distort_agrees_with_opencv(lens: Lens) -> None:
    rng = np.random.default_rng(1)
    slopes = rng.uniform(-0.5, 0.5, (200, 2))
    rays = np.column_stack([slopes, np.ones(200)])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion))
    np.testing.assert_allclose(lens.distort(slopes), expected[:, 0], atol=1e-9)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    k1=st.floats(-0.35, 0.3),
    k2=st.floats(-0.2, 0.3),
    k3=st.floats(-0.05, 0.05),
    p1=st.floats(-2e-3, 2e-3),
    p2=st.floats(-2e-3, 2e-3),
    focal=st.floats(2500, 8000),
)
def test_undistort_is_the_exact_inverse(k1: float, k2: float, k3: float, p1: float, p2: float, focal: float) -> None:
    lens = Lens(SIZE, (focal, focal * 1.001), (1930.0, 1300.0), (k1, k2, p1, p2, k3))
    pixels = grid()
    slopes = lens.undistort(pixels)
    found = np.isfinite(slopes).all(axis=1)
    np.testing.assert_allclose(lens.distort(slopes[found]), pixels[found], atol=2e-10)
    # Where nothing is found there is nothing: the radial part turns back before it gets there.
    assert found.all() or np.isfinite(lens.fold_radius)


def test_strong_distortion_folds_and_says_so() -> None:
    lens = Lens(SIZE, (2000.0, 2000.0), (1935.5, 1295.5), (-0.5, 0.0, 0.0, 0.0, 0.0))
    radius = lens.fold_radius
    assert radius == pytest.approx(np.sqrt(1 / 1.5))
    assert not lens.covers_image
    assert np.isnan(lens.undistort(np.array([[0.0, 0.0]]))).all()
    assert np.isnan(lens.distort(np.array([[radius * 1.01, 0.0]]))).all()
    # A ray beyond the fold would land on a pixel that belongs to another ray: only the inner one is returned.
    inner = np.array([[0.6, 0.1]])
    np.testing.assert_allclose(lens.undistort(lens.distort(inner)), inner, atol=1e-12)


def test_mild_lens_covers_its_image(lens: Lens) -> None:
    assert lens.covers_image
    assert lens.fold_radius == float("inf")


@pytest.mark.parametrize("folding", [False, True])
def test_jacobians_agree_with_differences(folding: bool) -> None:
    lens = Lens(SIZE, (3000.0, 3050.0), (1900.0, 1300.0), (-0.3 if folding else 0.1, 0.1, 1e-3, -2e-3, 0.02))
    rng = np.random.default_rng(2)
    slopes = rng.uniform(-0.4, 0.4, (20, 2))
    step = 1e-6
    numeric = np.stack(
        [(lens.distort(slopes + step * e) - lens.distort(slopes - step * e)) / (2 * step) for e in np.eye(2)], axis=-1
    )
    np.testing.assert_allclose(lens.distort_jacobian(slopes), numeric, rtol=1e-6, atol=1e-4)
    by_parameter = lens.parameter_jacobian(slopes)
    for column in range(9):
        change = np.zeros(9)
        change[column] = 1e-5 * max(1.0, abs(lens.parameters[column]))
        difference = lens.with_parameters(lens.parameters + change).distort(slopes)
        difference = difference - lens.with_parameters(lens.parameters - change).distort(slopes)
        np.testing.assert_allclose(by_parameter[:, :, column], difference / (2 * change[column]), rtol=1e-5, atol=1e-4)


def test_nonsense_is_refused() -> None:
    with pytest.raises(DataError, match="positive focal length"):
        Lens(SIZE, (0.0, 1.0), (1.0, 1.0))
    with pytest.raises(DataError, match="finite"):
        Lens(SIZE, (1.0, float("nan")), (1.0, 1.0))


def test_contains_counts_whole_pixels() -> None:
    lens = Lens((10, 5), (10.0, 10.0), (4.5, 2.0))
    inside = lens.contains(np.array([[-0.5, -0.5], [9.5, 4.5], [9.6, 0.0], [0.0, -0.6]]))
    assert inside.tolist() == [True, True, False, False]
