"""Hot and dead pixels: single ones that stand out from all neighbours of their own colour."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import FloatArray


def isolated(values: FloatArray, spacing: int, unclipped: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Pixels beyond the largest or below the smallest of their eight neighbours by more than the noise explains.

    A lens blurs every real detail over its neighbours, so a single pixel that exceeds all of them is the sensor's own.

    Parameters
    ----------
    values
        (h, w) counts above black, DN.
    spacing
        Distance to the next pixel of the same colour: 2 on a Bayer mosaic, 1 on a grey sensor.
    unclipped
        (h, w) bool of pixels that show the noise; all if None. Clipped ones show none.

    Returns
    -------
    (h, w) bool. The limit is six robust standard deviations of the difference between a pixel and its neighbours'
    mean, plus 4 DN for quantisation.
    """
    kernel = _neighbours(spacing)
    image = values.astype(np.float32)
    above = image - cv2.dilate(image, kernel, borderType=cv2.BORDER_REFLECT_101)
    below = cv2.erode(image, kernel, borderType=cv2.BORDER_REFLECT_101) - image
    mean = cv2.filter2D(image, -1, kernel / np.float32(8), borderType=cv2.BORDER_REFLECT_101)
    # Edges make the difference large in few pixels; the median of its size is the noise's.
    away = cv2.absdiff(image, mean)
    away = away.ravel() if unclipped is None or not unclipped.any() else away[unclipped]
    limit = 6.0 * 1.4826 * float(np.partition(away, away.size // 2)[away.size // 2]) + 4.0
    result: NDArray[np.bool_] = np.maximum(above, below) > limit
    return result


def within_neighbours(values: NDArray[Any], spacing: int) -> NDArray[Any]:
    """Each pixel brought within the range of its eight neighbours of the same colour: no hot or dead pixels are left.

    Parameters
    ----------
    values
        (h, w) counts.
    spacing
        As for `isolated`.

    Returns
    -------
    (h, w) of the same type. Noise is cut a little too: for finding and drawing, not for measuring.
    """
    kernel = _neighbours(spacing)
    highest = cv2.dilate(values, kernel, borderType=cv2.BORDER_REFLECT_101)
    lowest = cv2.erode(values, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(cv2.min(cv2.max(values, lowest), highest))


def _neighbours(spacing: int) -> NDArray[np.uint8]:
    kernel = np.zeros((2 * spacing + 1, 2 * spacing + 1), dtype=np.uint8)
    kernel[::spacing, ::spacing] = 1
    kernel[spacing, spacing] = 0
    return kernel
