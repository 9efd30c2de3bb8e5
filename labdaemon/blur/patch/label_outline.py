"""The label that a dot sits on: which pixels of a frame show nothing but label while the dot moves.

Background enters a pixel as soon as the moving edge of the label passes it, and no model of the dot explains it. So a
patch is masked to the pixels that lie on the label at every instant of the path. It does not matter whether the
background moves with the label or stands still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur.patch.pixels import BoolArray, FloatArray, Patch

ORBIT_NODES, STRAIGHT_NODES = 24, 9
"""Instants of an orbit, and of a straight path, at which the label is looked at. Numerics: labels are nearly convex."""


@dataclass(frozen=True, slots=True)
class LabelOutline:
    """The end of a label in polar coordinates about its dot.

    Attributes
    ----------
    distances_px
        Distance along rays evenly around the dot, from +x towards +y.
    """

    distances_px: tuple[float, ...]

    @property
    def nearest_px(self) -> float:
        """Distance of the nearest point."""
        return min(self.distances_px)

    def covers(self, x: FloatArray, y: FloatArray, margin_px: float = 0.0) -> BoolArray:
        """Whether points lie on the label, at least about `margin_px` from its end.

        Parameters
        ----------
        x, y
            Distances from the centre of the dot, px.
        """
        inverse = 1.0 / np.asarray(self.distances_px)
        place = np.arctan2(y, x) * (len(inverse) / (2.0 * np.pi))
        first = np.floor(place).astype(np.intp)
        part = place - first
        # A straight edge is nearly linear in the inverse distance; at corners the chord lies inside.
        ends = 1.0 / ((1.0 - part) * inverse[first % len(inverse)] + part * inverse[(first + 1) % len(inverse)])
        result: BoolArray = np.hypot(x, y) < ends - margin_px
        return result

    def clear_pixels(
        self,
        patch: Patch,
        centre_px: FloatArray,
        a_px: FloatArray,
        b_px: FloatArray,
        margin_px: float,
        *,
        step: int = 1,
    ) -> BoolArray:
        """(h, w) pixels that show nothing but the label at every instant of a path.

        Parameters
        ----------
        centre_px
            (2,) mean position of the dot in the frame.
        a_px, b_px
            (2,) semi-axes of its path.
        margin_px
            Distance from the end of the label that its blur fills.
        step
            Only one pixel in so many rows and columns is looked at, from the first one on.
        """
        height, width = patch.shape
        x = np.arange(0, width, step) + patch.origin_px[0] - centre_px[0]
        y = (np.arange(0, height, step) + patch.origin_px[1] - centre_px[1])[:, None]
        path = path_points(a_px, b_px)
        result = np.ones((y.size, x.size), dtype=bool)
        safe = self.nearest_px - margin_px
        far = np.hypot(x, y) + float(np.max(np.hypot(*path.T))) >= safe
        if not far.any():
            return result
        rows, columns = np.nonzero(far)
        ys, xs = y[rows, 0], x[columns]
        clear = np.ones(len(rows), dtype=bool)
        for dx, dy in path:
            clear &= self.covers(xs - dx, ys - dy, margin_px)
        result[rows, columns] = clear
        return result

    def holds(self, radius_px: float, a_px: FloatArray, b_px: FloatArray) -> bool:
        """Whether all of a blurred dot lies where there is label at every instant."""
        angle = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
        path = path_points(a_px, b_px)
        outline = radius_px * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        points = (path[:, None] + outline[None]).reshape(-1, 2)
        moved = points[None] - path[:, None]
        return bool(self.covers(moved[..., 0], moved[..., 1]).all())


def path_points(a_px: FloatArray, b_px: FloatArray) -> FloatArray:
    """(n, 2) displacements along an orbit, rest included; the ends of its axes are among them."""
    if not np.any(b_px):
        return np.linspace(-1.0, 1.0, STRAIGHT_NODES)[:, None] * a_px
    angle = np.linspace(0.0, 2.0 * np.pi, ORBIT_NODES, endpoint=False)
    path = np.sin(angle)[:, None] * a_px + np.cos(angle)[:, None] * b_px
    return np.concatenate((np.zeros((1, 2)), path))


def without_background(
    outline: LabelOutline, patch: Patch, centre_px: FloatArray, a_px: FloatArray, b_px: FloatArray, margin_px: float
) -> Patch:
    """The patch without values where its background enters; see `LabelOutline.clear_pixels`."""
    clear = outline.clear_pixels(patch, centre_px, a_px, b_px, margin_px)
    if clear.all():
        return patch
    # No value at all: a pixel that is merely invalid might be at white level.
    return Patch(np.where(clear, patch.values, np.nan), patch.channel, patch.valid & clear, patch.origin_px)
