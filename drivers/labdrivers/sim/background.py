"""What is not measured: the lab behind the structure, and the structure's own members, moving.

Drawn at half the sensor's resolution (a colour's own sites in a Bayer mosaic lie that far apart) with antialiased
edges: it has to look like a lab, nothing is read from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.lens import FloatArray
from labdrivers.sim.path import CameraView, moments
from labdrivers.sim.scene import Panel, Scene
from labdrivers.sim.sensor import FloatImage

HALF = 2
WALL_Y_MM = 800.0
"""The lab's far wall, parallel to the table's axis."""

WALL_X_MM, WALL_Z_MM = (-2300.0, 2300.0), (-900.0, 1700.0)
WALL_PX_PER_MM = 0.5

FULL_SCALE = 250.0
"""8-bit value of a reflectance of 1 while drawing."""

_SHIFT = 4


@lru_cache(maxsize=4)
def clutter(seed: int, count: int) -> NDArray[np.uint8]:
    """A wall with cupboards, cables and boxes before it, square on, (rows, columns, 3)."""
    rng = np.random.default_rng([seed, 31])
    width = round((WALL_X_MM[1] - WALL_X_MM[0]) * WALL_PX_PER_MM)
    height = round((WALL_Z_MM[1] - WALL_Z_MM[0]) * WALL_PX_PER_MM)
    ramp = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None]
    wall = np.array([0.20, 0.205, 0.21], np.float32) * (1.05 - 0.25 * ramp) * FULL_SCALE
    image = np.repeat(wall, width, axis=1)
    mottle = cv2.resize(
        rng.normal(0.0, 2.5, (12, 18)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC
    )
    canvas = np.clip(image + mottle[:, :, None], 0, 255).astype(np.uint8)
    for _ in range(count):
        grey = rng.uniform(0.06, 0.5)
        colour = tuple(float(c) for c in np.clip(grey * rng.uniform(0.8, 1.2, 3), 0.03, 0.6) * FULL_SCALE)
        centre = rng.uniform((0.0, 0.0), (width, height))
        kind = rng.uniform()
        if kind < 0.55:
            size = rng.uniform(0.01, 0.09, 2) * width
            box = cv2.boxPoints((tuple(centre), tuple(size), float(rng.normal(0.0, 3.0))))
            cv2.fillConvexPoly(canvas, np.rint(box * 2**_SHIFT).astype(np.int32), colour, cv2.LINE_AA, _SHIFT)
        elif kind < 0.75:
            radius = float(rng.uniform(0.003, 0.016) * width)
            middle = tuple(int(v) for v in np.rint(centre * 2**_SHIFT))
            cv2.circle(canvas, middle, int(radius * 2**_SHIFT), colour, -1, cv2.LINE_AA, _SHIFT)
            # a slotted knob: round things are about, but none that a person would take for a target
            slot = rng.normal(size=2)
            slot *= radius / np.linalg.norm(slot)
            ends = [tuple(int(v) for v in np.rint((centre + side * slot) * 2**_SHIFT)) for side in (-1, 1)]
            lighter = tuple(min(1.6 * c + 30.0, 160.0) for c in colour)
            cv2.line(canvas, ends[0], ends[1], lighter, max(2, int(radius / 3)), cv2.LINE_AA, _SHIFT)
        else:
            knots = centre + np.cumsum(rng.normal(0.0, 0.02 * width, (6, 2)), axis=0)
            t = np.linspace(0, 5, 60)
            straight = np.stack([np.interp(t, np.arange(6), knots[:, k]) for k in (0, 1)], axis=1)
            cable = cv2.GaussianBlur(straight.astype(np.float32), (1, 21), 4.0)
            points = np.rint(cable * 2**_SHIFT).astype(np.int32)
            cv2.polylines(canvas, [points], False, colour, int(rng.integers(2, 6)), cv2.LINE_AA, _SHIFT)
    canvas.flags.writeable = False
    return canvas


@lru_cache(maxsize=4)
def far_wall(seed: int, count: int, view: CameraView, width: int, height: int) -> NDArray[np.uint8]:
    """The wall as a camera sees it, (height, width, 3) at half resolution, its lens's distortion aside."""
    x, z = np.array(WALL_X_MM), np.array(WALL_Z_MM)
    wall = np.array(
        [(x[0], WALL_Y_MM, z[1]), (x[1], WALL_Y_MM, z[1]), (x[1], WALL_Y_MM, z[0]), (x[0], WALL_Y_MM, z[0])]
    )
    drawn = clutter(seed, count)
    rows, columns = drawn.shape[:2]
    corners = np.array([(0, 0), (columns - 1, 0), (columns - 1, rows - 1), (0, rows - 1)], np.float32)
    straight = replace(view.camera, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    seen = CameraView(straight, view.shift).project(wall)
    there = cv2.getPerspectiveTransform(corners, ((seen - 0.5) / HALF).astype(np.float32))
    image = np.asarray(
        cv2.warpPerspective(drawn, there, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT),
        np.uint8,
    )
    image.flags.writeable = False
    return image


def backdrop(
    scene: Scene,
    view: CameraView,
    motion: Callable[[FloatArray], FloatArray] | None,
    window_s: tuple[float, float],
    blur_px: float,
    samples: int = 40,
) -> FloatImage:
    """Reflectance (h/2, w/2, 3) of everything but labels and control targets, averaged over the exposure.

    Parameters
    ----------
    motion
        Displacement (corners, n, 3) of the moving panels' corners at times (n,); None at rest.
    blur_px
        Standard deviation of the lens's blur, full-resolution pixels.
    """
    full_width, full_height = view.camera.image_size
    width, height = (full_width + 1) // HALF, (full_height + 1) // HALF
    still = far_wall(scene.seed, scene.clutter, view, width, height)
    corners = np.array([panel.corners_mm for panel in scene.panels], float).reshape(-1, 3)
    total: FloatImage
    if motion is None or not any(panel.moving for panel in scene.panels):
        canvas = still.copy()
        _draw(canvas, scene.panels, view.project(corners) if corners.size else corners)
        total = canvas.astype(np.float32)
    else:
        moves = np.repeat([panel.moving for panel in scene.panels], 4)[:, None]
        total = np.zeros((height, width, 3), np.float32)
        displaced = motion(moments(*window_s, samples))
        for k in range(samples):
            canvas = still.copy()
            _draw(canvas, scene.panels, view.project(corners + np.where(moves, displaced[:, k], 0.0)))
            cv2.accumulate(canvas, total)
        total /= samples
    cv2.GaussianBlur(total, (0, 0), max(blur_px / HALF, 0.3), dst=total)
    total /= FULL_SCALE
    return total


def _draw(canvas: NDArray[np.uint8], panels: tuple[Panel, ...], corners_px: FloatArray) -> None:
    for index, panel in enumerate(panels):
        half = (corners_px[4 * index : 4 * index + 4] - 0.5) / HALF
        colour = tuple(c * FULL_SCALE for c in panel.reflectance)
        cv2.fillConvexPoly(canvas, np.rint(half * 2**_SHIFT).astype(np.int32), colour, cv2.LINE_AA, _SHIFT)
