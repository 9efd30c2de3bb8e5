from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.ellipse import fit_ellipse
from labdaemon.imaging.eccentricity import centre_shift, ellipse_centre


def circle(centre: np.ndarray, normal: np.ndarray, radius: float) -> np.ndarray:
    u = np.cross(normal, [0.3, 0.9, 0.1])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None]
    return centre + radius * (np.cos(t) * u + np.sin(t) * v)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-400, 400),
    st.floats(-300, 300),
    st.floats(500, 2000),
    st.floats(0, 1.2),
    st.floats(0, 6.3),
    st.floats(2, 30),
)
def test_closed_form_against_an_ellipse_fitted_to_projected_points(
    x: float, y: float, z: float, tilt: float, turn: float, radius: float
) -> None:
    centre = np.array([x, y, z])
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    points = circle(centre, normal, radius)
    fitted = fit_ellipse(points[:, :2] / points[:, 2:] * 4000.0)
    assert fitted is not None
    assert ellipse_centre(centre, normal, radius) * 4000.0 == pytest.approx((fitted.x_px, fitted.y_px), abs=2e-3)


def test_a_circle_faced_squarely_on_the_axis_does_not_shift() -> None:
    assert centre_shift(np.array([0, 0, 1000.0]), np.array([0, 0, 1.0]), 4.0) == pytest.approx((0, 0))


def test_many_at_once_and_the_size_of_it() -> None:
    centre, normal = np.tile([0, 0, 1000.0], (2, 1)), np.tile([np.sqrt(0.5), 0, np.sqrt(0.5)], (2, 1))
    shift = centre_shift(centre, normal, np.array([4.0, 18.0])) * 3937.7
    assert np.hypot(*shift.T) == pytest.approx([0.0315, 0.638], abs=1e-3)
