"""The straight sides of a coded target, fitted on the mosaic itself, and the corners where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from labdaemon.blur import Patch

FloatArray = NDArray[np.float64]

_ITERATIONS = 12  # a robust line has converged after four or five


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
    levels: list[FloatArray] = []
    keep = np.zeros(len(value), dtype=np.bool_)
    which = np.zeros(len(value), dtype=np.intp)
    for k in np.unique(channel):
        of_channel = channel == k
        # Where paper is clipped, only the noise's dark half remains of it: better without that channel.
        outside = np.abs(along) <= length / 2.0 - guard_px
        outside &= (across > 0.0) & (across <= band_px) & (patch.channel == k)
        level = _start_level(d[of_channel], value[of_channel], band_px)
        if level is not None and patch.valid[outside].mean() > 0.9:
            which[of_channel] = len(levels)
            levels.append(level)
            keep |= of_channel
    if keep.sum() < 40:
        return None
    u, d, value, which = u[keep], d[keep], value[keep], which[keep]
    return _gauss_newton(start_px, end_px, u, d, value, which, np.array(levels), curved=length >= 40.0, band_px=band_px)


def _start_level(d: FloatArray, value: FloatArray, band_px: float) -> FloatArray | None:
    """(2,) ink and paper of a channel from the outer thirds of the band; None without contrast."""
    inside, outside = value[d < -band_px / 3], value[d > band_px / 3]
    if not inside.size or not outside.size:
        return None
    ink, paper = float(np.median(inside)), float(np.median(outside))
    return np.array([ink, paper]) if paper > ink else None


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


def corners_of(sides: Sequence[Side]) -> tuple[FloatArray, FloatArray] | None:
    """Where each of four sides meets the one before it.

    Returns
    -------
    (4, 2) corners, px, the first at the start of the first side, and the (8, 8) covariance of x0, y0, x1 … (px²), which
    carries that neighbours share a side; None where two sides are nearly parallel.
    """
    corners, jacobian = np.empty((4, 2)), np.zeros((8, 12))
    for k in range(4):
        before, after = sides[k - 1], sides[k]
        normals = np.stack([before.normal, after.normal])
        if abs(np.linalg.det(normals)) < 0.1:
            return None
        point = np.asarray(after.start_px, dtype=np.float64)
        for _ in range(4):
            distances = np.array([before.place(point)[1], after.place(point)[1]])
            point = point - np.linalg.solve(normals, distances)
        corners[k] = point
        inverse = np.linalg.inv(normals)
        for column, (side, index) in enumerate(((before, (k - 1) % 4), (after, k))):
            u = side.place(point)[0]
            jacobian[2 * k : 2 * k + 2, 3 * index : 3 * index + 3] = np.outer(inverse[:, column], [1.0, u, u * u])
    variance = np.zeros((12, 12))
    for k, side in enumerate(sides):
        variance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = side.covariance_px2
    return corners, jacobian @ variance @ jacobian.T
