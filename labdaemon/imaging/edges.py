"""The straight sides of a coded target, fitted on the mosaic itself, and the corners where they meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from labdaemon.blur.pixels import Patch

FloatArray = NDArray[np.float64]

_ITERATIONS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A fitted side: its distance from the chord between two approximate corners, e(u) = e0 + e1 u + e2 u².

    Attributes
    ----------
    start_px, end_px
        (2,) ends of the chord.
    offset_px
        (3,) e0, e1, e2 in px; u runs from −1 at the start to 1 at the end; positive to the right of start → end as seen
        with y down turned by −90°, that is along (ty, −tx), the outside of a clockwise quadrilateral.
    covariance_px2
        (3, 3) of the offsets, scaled by the residuals.
    contrast
        Outside less inside, in parts of the outside, averaged over channels.
    """

    start_px: FloatArray
    end_px: FloatArray
    offset_px: FloatArray
    covariance_px2: FloatArray
    contrast: float

    @property
    def tangent(self) -> FloatArray:
        """(2,) unit vector from start to end."""
        chord = self.end_px - self.start_px
        return np.asarray(chord / np.hypot(*chord))

    @property
    def normal(self) -> FloatArray:
        """(2,) unit vector to the outside."""
        tx, ty = self.tangent
        return np.array([ty, -tx])

    def place(self, point: FloatArray) -> tuple[float, float]:
        """(u, distance from the fitted side, px) of a point."""
        middle, half = (self.start_px + self.end_px) / 2.0, np.hypot(*(self.end_px - self.start_px)) / 2.0
        u = float((point - middle) @ self.tangent / half)
        return u, float((point - middle) @ self.normal - np.polyval(self.offset_px[::-1], u))

    def sd_px(self, u: float) -> float:
        """Standard deviation of the side's place at u."""
        row = np.array([1.0, u, u * u])
        return float(np.sqrt(max(row @ self.covariance_px2 @ row, 0.0)))


def fit_side(patch: Patch, start_px: FloatArray, end_px: FloatArray, *, band_px: float, guard_px: float) -> Side | None:
    """Fit the edge between dark inside and white outside along one side of a clockwise quadrilateral.

    Parameters
    ----------
    patch
        Mosaic around the target.
    start_px, end_px
        (2,) approximate corners, within `band_px` of the true ones.
    band_px
        Pixels this far from the chord take part: less than the width of the dark border.
    guard_px
        Length left out at both ends, where the other sides blur in.

    Returns
    -------
    The side, or None where the pixels show no such edge.

    Notes
    -----
    Each colour channel has its own ink and paper level, the paper a linear gradient along the side; the edge is a
    Gaussian-blurred step whose place is a parabola in u (a lens bends straight sides). Gauss–Newton on the pixels as
    they are, so nothing is interpolated.
    """
    chord = end_px - start_px
    length = float(np.hypot(*chord))
    if length < 2.0 * guard_px + 6.0:
        return None
    tangent = chord / length
    normal = np.array([tangent[1], -tangent[0]])
    middle = (start_px + end_px) / 2.0
    ys, xs = np.mgrid[0 : patch.shape[0], 0 : patch.shape[1]]
    dx, dy = xs + patch.origin_px[0] - middle[0], ys + patch.origin_px[1] - middle[1]
    along, across = dx * tangent[0] + dy * tangent[1], dx * normal[0] + dy * normal[1]
    chosen = (np.abs(across) <= band_px) & (np.abs(along) <= length / 2.0 - guard_px) & patch.valid
    if chosen.sum() < 40:
        return None
    u, d, value, channel = along[chosen] / (length / 2.0), across[chosen], patch.values[chosen], patch.channel[chosen]
    present, which = np.unique(channel, return_inverse=True)
    levels = _start_levels(d, value, which, len(present), band_px)
    if levels is None:
        return None
    return _gauss_newton(start_px, end_px, u, d, value, which, levels, curved=length >= 40.0, band_px=band_px)


def _start_levels(
    d: FloatArray, value: FloatArray, which: NDArray[np.intp], count: int, band_px: float
) -> FloatArray | None:
    """(count, 2) ink and paper of each channel from the outer thirds of the band; None without contrast."""
    levels = np.empty((count, 2))
    for k in range(count):
        inside, outside = value[(which == k) & (d < -band_px / 3)], value[(which == k) & (d > band_px / 3)]
        if not inside.size or not outside.size:
            return None
        levels[k] = np.median(inside), np.median(outside)
    return levels if bool(np.all(levels[:, 1] > levels[:, 0])) else None


def _gauss_newton(
    start_px: FloatArray,
    end_px: FloatArray,
    u: FloatArray,
    d: FloatArray,
    value: FloatArray,
    which: NDArray[np.intp],
    levels: FloatArray,
    *,
    curved: bool,
    band_px: float,
) -> Side | None:
    count, terms = len(levels), 3 if curved else 2
    offset, sigma, gradient = np.zeros(3), 0.9, 0.0
    powers = np.stack([np.ones_like(u), u, u * u], axis=1)[:, :terms]
    rows = np.arange(len(u))
    for _ in range(_ITERATIONS):
        z = (d - powers @ offset[:terms]) / sigma
        cover, density = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        ink, paper = levels[which, 0], levels[which, 1]
        bright = paper * (1.0 + gradient * u)
        model = ink + (bright - ink) * cover
        slope = (bright - ink) * density / sigma
        jacobian = np.zeros((len(u), terms + 2 + 2 * count))
        jacobian[:, :terms] = -slope[:, None] * powers
        jacobian[:, terms] = -slope * z
        jacobian[:, terms + 1] = paper * u * cover
        jacobian[rows, terms + 2 + which] = 1.0 - cover
        jacobian[rows, terms + 2 + count + which] = (1.0 + gradient * u) * cover
        residual = value - model
        scale = np.maximum(np.sqrt((jacobian**2).sum(axis=0)), 1e-12)
        step = np.linalg.lstsq(jacobian / scale, residual, rcond=None)[0] / scale
        offset[:terms] += np.clip(step[:terms], -1.0, 1.0)
        sigma = float(np.clip(sigma + step[terms], 0.3, band_px))
        gradient += float(step[terms + 1])
        levels = levels + np.stack([step[terms + 2 : terms + 2 + count], step[terms + 2 + count :]], axis=1)
        if np.abs(step[:terms]).max() < 1e-5:
            break
    freedom = len(u) - jacobian.shape[1]
    if freedom < 10 or not np.isfinite(offset).all() or np.abs(offset).max() > band_px:
        return None
    normal_matrix = (jacobian / scale).T @ (jacobian / scale)
    inverse = np.linalg.pinv(normal_matrix) / np.outer(scale, scale) * float(residual @ residual) / freedom
    covariance = np.zeros((3, 3))
    covariance[:terms, :terms] = inverse[:terms, :terms]
    contrast = float(np.mean((levels[:, 1] - levels[:, 0]) / np.maximum(levels[:, 1], 1e-9)))
    return Side(start_px, end_px, offset, covariance, contrast)


def corner(before: Side, after: Side) -> tuple[FloatArray, FloatArray] | None:
    """Where one side ends and the next begins: (2,) point and its (2, 2) covariance, px².

    None where the sides are nearly parallel or do not meet near their ends.
    """
    point = np.asarray(before.end_px, dtype=np.float64)
    normals = np.stack([before.normal, after.normal])
    if abs(np.linalg.det(normals)) < 0.1:
        return None
    for _ in range(4):
        distances = np.array([before.place(point)[1], after.place(point)[1]])
        point = point - np.linalg.solve(normals, distances)
    u_before, u_after = before.place(point)[0], after.place(point)[0]
    inverse = np.linalg.inv(normals)
    variance = np.diag([before.sd_px(u_before) ** 2, after.sd_px(u_after) ** 2])
    return point, inverse @ variance @ inverse.T
