"""A target's image, what the measured motion says it should be, and their difference, side by side.

The model is the definition of motion blur (McCarthy 2016, equation (1)): the target at rest, displaced along the
measured path and averaged over the exposure. It is made of pixels of the sharp frame, not of the fit's own target, so
that it shows the same whatever method measured. Brightness, contrast and a remaining shift are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]

CYCLE_NODES = 96
"""Instants of a cycle: closer than a pixel for paths of 30 px."""
SEARCH_PX = 12
"""How far the target may have shifted as a whole since the sharp frame: a tripod that was touched."""
RESIDUAL_SHARE = 0.2
"""Difference, as a share of the contrast, that is drawn black or white."""
GREY_LEVELS = 24
"""Of the drawing; more would only make the noise larger as a file."""
MAX_SIDE = 64
"""Of a drawn panel, px."""
_GAP = 4


@dataclass(frozen=True, slots=True, eq=False)
class PathWeights:
    """Where a target was during the exposure.

    Attributes
    ----------
    displacement_px
        (K, 2) from its mean, x and y.
    weight
        (K,) share of the light at each place; sums to 1.
    """

    displacement_px: FloatArray
    weight: FloatArray

    @classmethod
    def of(
        cls, a_px: FloatArray, b_px: FloatArray, phase_rad: FloatArray | None = None, light: FloatArray | None = None
    ) -> PathWeights:
        """The path ``a sin θ + b cos θ``.

        Parameters
        ----------
        a_px, b_px
            (2,) vectors.
        phase_rad
            (K,) equally spaced instants; one whole cycle if None.
        light
            (K,) brightness of the lamp at these; constant if None.
        """
        whole = 2 * np.pi * (np.arange(CYCLE_NODES) + 0.5) / CYCLE_NODES
        theta = whole if phase_rad is None else phase_rad
        weight = np.ones(len(theta)) if light is None else np.asarray(light, float)
        weight = weight / weight.sum()
        path = np.outer(np.sin(theta), a_px) + np.outer(np.cos(theta), b_px)
        return cls(path - weight @ path, weight)

    @property
    def reach_px(self) -> float:
        """Largest distance from the mean."""
        return float(np.hypot(*self.displacement_px.T).max())


def modelled_patch(sharp: FloatArray, path: PathWeights, blurred: FloatArray) -> FloatArray:
    """The sharp patch moved along a path, with shift, brightness and contrast of the blurred one.

    Parameters
    ----------
    sharp, blurred
        (h, w) cut at the same place of both frames.
    path
        The measured motion.

    Returns
    -------
    array
        (h, w) in the unit of `blurred`.
    """
    still = sharp.astype(np.float32)
    moved = np.zeros_like(still)
    for (dx, dy), weight in zip(path.displacement_px, path.weight, strict=True):
        moved += np.float32(weight) * _shifted(still, dx, dy)
    shift = _coarse_shift(moved, blurred.astype(np.float32))
    model = blurred
    for _ in range(3):
        candidate = _shifted(moved, *shift).astype(float)
        down, across = np.gradient(candidate)
        columns = np.stack([candidate, np.ones_like(candidate), -across, -down], axis=2)
        inner = _inner(columns).reshape(-1, 4), _inner(blurred).ravel()
        gain, offset, x, y = np.linalg.lstsq(*inner, rcond=None)[0]
        model = gain * candidate + offset
        if gain <= 0:
            break
        shift = shift + np.clip(np.array([x, y]) / gain, -1.0, 1.0)
    return np.asarray(model)


def patch_strip(blurred: FloatArray, model: FloatArray | None) -> Image:
    """Image, model and difference as one drawing, (h', w') 8-bit grey; the image alone where there is no model.

    The difference is grey where there is none, and black or white from `RESIDUAL_SHARE` of the contrast on.
    """
    seen = blurred if model is None else model
    low, high = (float(np.quantile(seen, share)) for share in (0.005, 0.995))
    contrast = max(high - low, 1e-9)
    panels = [(blurred - low) / contrast]
    if model is not None:
        panels += [(model - low) / contrast, 0.5 + (blurred - model) / (2 * RESIDUAL_SHARE * contrast)]
    drawn = [_drawing(panel) for panel in panels]
    gap = np.full((drawn[0].shape[0], _GAP), 255, np.uint8)
    parts = [part for panel in drawn for part in (panel, gap)][:-1]
    return np.asarray(np.hstack(parts), np.uint8)


def _drawing(panel: FloatArray) -> Image:
    scale = min(1.0, MAX_SIDE / max(panel.shape))
    size = (max(1, round(panel.shape[1] * scale)), max(1, round(panel.shape[0] * scale)))
    small = cv2.resize(panel.astype(np.float32), size, interpolation=cv2.INTER_AREA) if scale < 1 else panel
    levels = np.rint(np.clip(small, 0.0, 1.0) * (GREY_LEVELS - 1))
    return np.asarray(levels * (255 // (GREY_LEVELS - 1)), np.uint8)


def _shifted(image: NDArray[np.float32], dx: float, dy: float) -> NDArray[np.float32]:
    matrix = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
    moved = cv2.warpAffine(image, matrix, image.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float32)


def _coarse_shift(moved: NDArray[np.float32], blurred: NDArray[np.float32]) -> FloatArray:
    """Whole pixels by which the blurred target differs from the model."""
    room = min(SEARCH_PX, min(moved.shape) // 6)
    if room < 1:
        return np.zeros(2)
    likeness = cv2.matchTemplate(blurred, moved[room:-room, room:-room], cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(np.argmax(likeness)), likeness.shape)
    return np.array([float(column) - room, float(row) - room])


def _inner(array: FloatArray) -> FloatArray:
    """The middle of a patch: what the target itself covers, without the background that does not move with it."""
    h, w = array.shape[:2]
    return array[h // 8 : h - h // 8, w // 8 : w - w // 8]
