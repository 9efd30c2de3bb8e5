"""Ellipses: fitted to points by least squares, and read from second moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdaemon.half_turn import within_half_turn

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse in a frame.

    Attributes
    ----------
    x_px, y_px
        Centre.
    semi_major_px, semi_minor_px
        Semi-axes, major ≥ minor > 0.
    angle_rad
        From +x towards +y to the major axis, in (−π/2, π/2].
    """

    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float

    @property
    def mean_radius_px(self) -> float:
        """Radius of the circle of equal area."""
        return float(np.sqrt(self.semi_major_px * self.semi_minor_px))

    @property
    def axes_matrix(self) -> FloatArray:
        """(2, 2) that takes the unit circle to the ellipse about its centre; columns are the semi-axes."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.array(
            [[self.semi_major_px * c, -self.semi_minor_px * s], [self.semi_major_px * s, self.semi_minor_px * c]]
        )

    def points(self, angles_rad: NDArray[np.floating], scale: float | FloatArray = 1.0) -> FloatArray:
        """(…, 2) points at eccentric angles, on the ellipse enlarged `scale` times about its centre."""
        unit = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=-1) * np.asarray(scale)[..., None]
        return np.asarray(unit @ self.axes_matrix.T + np.array([self.x_px, self.y_px]))

    def radii(self, points: FloatArray) -> FloatArray:
        """(…) distance of points (…, 2) from the centre in units of the ellipse: 1 on it."""
        local = (points - np.array([self.x_px, self.y_px])) @ np.linalg.inv(self.axes_matrix).T
        return np.asarray(np.hypot(local[..., 0], local[..., 1]))


def ellipse_from_moments(x_px: float, y_px: float, xx: float, xy: float, yy: float) -> Ellipse | None:
    """Filled ellipse with a given centre and central second moments (px²); None if it has no extent.

    A filled ellipse's variance along a semi-axis s is s²/4.
    """
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    if values[0] <= 0.0:
        return None
    major = vectors[:, 1]
    return Ellipse(x_px, y_px, 2.0 * float(np.sqrt(values[1])), 2.0 * float(np.sqrt(values[0])), _axis_angle(major))


def fit_ellipse(points: FloatArray) -> Ellipse | None:
    """Ellipse through points by direct least squares; None where they lie on no ellipse.

    Parameters
    ----------
    points
        (n, 2), n ≥ 6, px.

    Notes
    -----
    Fitzgibbon, Pilu and Fisher (1999) in the stable form of Halíř and Flusser (1998): the conic's coefficients under
    4AC − B² = 1, on coordinates brought to unit size.
    """
    if len(points) < 6:
        return None
    shift = points.mean(axis=0)
    size = float(np.abs(points - shift).max())
    if not np.isfinite(size) or size == 0.0:
        return None
    x, y = ((points - shift) / size).T
    quadratic, linear = np.stack([x * x, x * y, y * y], axis=1), np.stack([x, y, np.ones_like(x)], axis=1)
    s1, s2, s3 = quadratic.T @ quadratic, quadratic.T @ linear, linear.T @ linear
    try:
        eliminate = -np.linalg.solve(s3, s2.T)
        reduced = s1 + s2 @ eliminate
        # Rows times the inverse of the constraint matrix [[0, 0, 2], [0, -1, 0], [2, 0, 0]].
        values, vectors = np.linalg.eig(np.stack([reduced[2] / 2.0, -reduced[1], reduced[0] / 2.0]))
    except np.linalg.LinAlgError:  # all points lie in a line: no ellipse passes through them
        return None
    vectors = np.real(vectors)
    elliptic = 4.0 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0.0
    if not elliptic.any() or not np.isfinite(values).all():
        return None
    a, b, c = vectors[:, np.argmax(elliptic)]
    d, e, f = eliminate @ np.array([a, b, c])
    return _ellipse_from_conic(np.array([a, b, c, d, e, f]), shift, size)


def _ellipse_from_conic(conic: FloatArray, shift: FloatArray, size: float) -> Ellipse | None:
    a, b, c, d, e, f = conic
    form = np.array([[a, b / 2.0], [b / 2.0, c]])
    centre = np.linalg.solve(form, [-d / 2.0, -e / 2.0])
    level = -(f + 0.5 * (d * centre[0] + e * centre[1]))
    values, vectors = np.linalg.eigh(form * np.sign(level)) if level != 0.0 else (np.zeros(2), np.eye(2))
    if values[0] <= 0.0:
        return None
    minor, major = np.sqrt(abs(level) / values[1]) * size, np.sqrt(abs(level) / values[0]) * size
    x, y = centre * size + shift
    return Ellipse(float(x), float(y), float(major), float(minor), _axis_angle(vectors[:, 0]))


def _axis_angle(axis: FloatArray) -> float:
    return within_half_turn(float(np.arctan2(axis[1], axis[0])))
