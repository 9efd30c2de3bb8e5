from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.ellipse import Ellipse, ellipse_from_moments, fit_ellipse

ellipses = st.builds(
    Ellipse,
    st.floats(-2000, 4000),
    st.floats(-2000, 4000),
    st.floats(20, 100),
    st.floats(5, 19),
    st.floats(-1.5, 1.5),
)


@settings(max_examples=50, deadline=None)
@given(ellipses, st.floats(0, 6), st.floats(2.5, 6.2))
def test_points_on_an_ellipse_give_it_back(shape: Ellipse, start: float, span: float) -> None:
    found = fit_ellipse(shape.points(np.linspace(start, start + span, 40)))
    assert found is not None
    assert (found.x_px, found.y_px) == pytest.approx((shape.x_px, shape.y_px), abs=1e-3)
    assert found.semi_major_px == pytest.approx(shape.semi_major_px, rel=1e-4)
    assert found.semi_minor_px == pytest.approx(shape.semi_minor_px, rel=1e-4)
    assert np.cos(2 * (found.angle_rad - shape.angle_rad)) == pytest.approx(1.0, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(ellipses)
def test_moments_of_its_pixels_give_it_back(shape: Ellipse) -> None:
    local = Ellipse(0.0, 0.0, shape.semi_major_px, shape.semi_minor_px, shape.angle_rad)
    y, x = np.mgrid[-105:106:0.5, -105:106:0.5]
    inside = local.radii(np.stack([x, y], axis=-1)) <= 1.0
    xs, ys = x[inside], y[inside]
    found = ellipse_from_moments(0.0, 0.0, float(np.mean(xs * xs)), float(np.mean(xs * ys)), float(np.mean(ys * ys)))
    assert found is not None
    assert found.semi_major_px == pytest.approx(shape.semi_major_px, rel=0.02)
    assert found.semi_minor_px == pytest.approx(shape.semi_minor_px, rel=0.02)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((3, 2)),
        np.zeros((20, 2)),
        np.stack([np.arange(20.0), np.zeros(20)], axis=1),
        np.stack([np.cosh(np.linspace(-1, 1, 20)), np.sinh(np.linspace(-1, 1, 20))], axis=1) * 1e9,
    ],
)
def test_points_on_no_ellipse_give_none_or_an_ellipse_never_an_error(points: np.ndarray) -> None:
    found = fit_ellipse(points)
    assert found is None or found.semi_minor_px >= 0.0
