"""Figure of a camera calibration's residuals: what the lens model does not explain, over the frame."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WIDTH_PX = 1400
"""Width of the image."""
_CELLS = 12  # across the frame: systematic residuals of a lens show, single ones do not


def draw_residuals(
    image_size: tuple[int, int], image_px: FloatArray, residuals_px: FloatArray, sigma0_px: float, title: str
) -> NDArray[np.uint8]:
    """Draw every residual, magnified, and their mean in each part of the frame.

    Single residuals (grey) are noise and should point anywhere; means (red) that line up are a lens model that does
    not fit.

    Parameters
    ----------
    image_size
        (width, height) of the frame, px.
    image_px, residuals_px
        (n, 2) points and residuals, px.
    sigma0_px
        Their standard deviation; the magnification makes it 1 % of the image's width.
    title
        Line above the image.

    Returns
    -------
    NDArray
        (h, w, 3) image, blue first, as OpenCV writes it.
    """
    scale = WIDTH_PX / image_size[0]
    height = int(np.ceil(image_size[1] * scale))
    magnify = 0.01 * WIDTH_PX / max(sigma0_px, 1e-6)
    image = np.full((height + 60, WIDTH_PX, 3), 255, dtype=np.uint8)
    cv2.rectangle(image, (0, 60), (WIDTH_PX - 1, height + 59), (160, 160, 160), 1)
    starts = (image_px + 0.5) * scale + np.array([0.0, 60.0])
    for start, residual in zip(starts, residuals_px, strict=True):
        _line(image, start, residual * magnify, (170, 170, 170), 1)
    cell = np.clip((image_px / np.array(image_size) * _CELLS).astype(int), 0, _CELLS - 1)
    for column in range(_CELLS):
        for row in range(_CELLS):
            here = (cell[:, 0] == column) & (cell[:, 1] == row)
            if here.sum() >= 5:
                _line(image, starts[here].mean(axis=0), residuals_px[here].mean(axis=0) * magnify, (0, 0, 220), 2)
    text = f"{title}   sigma0 {sigma0_px:.3f} px = {magnify * sigma0_px:.0f} px here; red: means of parts of the frame"
    cv2.putText(image, text, (12, 38), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (40, 40, 40), 1, cv2.LINE_AA)
    return image


def _line(
    image: NDArray[np.uint8], start: FloatArray, vector: FloatArray, colour: tuple[int, int, int], width: int
) -> None:
    """Arrow with sixteenths of a pixel."""
    ends = [tuple(round(16.0 * float(value)) for value in point) for point in (start, start + vector)]
    cv2.line(image, ends[0], ends[1], colour, width, cv2.LINE_AA, 4)
    cv2.circle(image, ends[0], 24 * width, colour, -1, cv2.LINE_AA, 4)
