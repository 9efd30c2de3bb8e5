"""First sieve for dots: dark, compact regions surrounded by something brighter, at every size."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import Ellipse, ellipse_from_moments
from labdaemon.imaging.frame import Grey

REDUCED_RANGE_PX = (5.0, 26.0)
"""Diameters looked for in each reduced image."""

DARKER_THAN = (0.80, 0.60)
"""Thresholds, in parts of the surrounding brightness; both in square-root light."""

MIN_AXIS_RATIO = 0.2  # a disc seen at 78°; flatter blobs are edges and text


def find_blobs(grey: Grey, diameter_range_px: tuple[float, float]) -> list[Ellipse]:
    """Dark regions whose area and second moments are those of a filled ellipse.

    The image is reduced by powers of two so that every diameter is looked for at 5 to 26 reduced pixels. In each, a
    morphological closing wider than the largest dot puts in place of every dark region the brightness around it; what
    is well below that is a candidate. Unlike a threshold from local means it is not misled by what lies beyond the
    paper.

    Parameters
    ----------
    grey
        (h, w), linear.
    diameter_range_px
        Smallest and largest major diameter.

    Returns
    -------
    Candidates good to about a pixel; the same dot may come more than once.
    """
    smallest, largest = diameter_range_px
    factor = 1
    while smallest / (2 * factor) >= REDUCED_RANGE_PX[0]:
        factor *= 2
    found: list[Ellipse] = []
    while True:
        found += _at_scale(grey, factor, diameter_range_px)
        if factor * REDUCED_RANGE_PX[1] >= largest:
            return found
        factor *= 4


def _at_scale(grey: Grey, factor: int, diameter_range_px: tuple[float, float]) -> list[Ellipse]:
    height, width = grey.shape[0] // factor, grey.shape[1] // factor
    if height < 8 or width < 8:
        return []
    cut = grey[: height * factor, : width * factor]
    reduced = cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA) if factor > 1 else cut
    # Square-root light in eight bits: photon noise is then even, and dark and bright paper are treated equally.
    image = cv2.convertScaleAbs(cv2.sqrt(np.maximum(reduced, 0.0)), alpha=255.0)
    reach = int(min(REDUCED_RANGE_PX[1], diameter_range_px[1] / factor) * 1.25) // 2 * 2 + 3
    around = cv2.morphologyEx(image, cv2.MORPH_CLOSE, np.ones((reach, reach), dtype=np.uint8))
    low = max(REDUCED_RANGE_PX[0], diameter_range_px[0] / factor)
    high = min(REDUCED_RANGE_PX[1], diameter_range_px[1] / factor) + 2.0
    found: list[Ellipse] = []
    for part in DARKER_THAN:
        dark = cv2.compare(image, cv2.convertScaleAbs(around, alpha=part), cv2.CMP_LT)
        found += _compact(dark, (low * 0.8, high * 1.1), factor)
    return found


def _compact(dark: NDArray[Any], extent: tuple[float, float], factor: int) -> list[Ellipse]:
    """Connected regions whose area is that of the ellipse with their second moments, in full-size coordinates."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=4)
    height, width = dark.shape
    x, y, w, h = stats.T[:4]
    longer, shorter = np.maximum(w, h), np.minimum(w, h)
    inside = (x > 0) & (y > 0) & (x + w < width) & (y + h < height)
    likely = inside & (longer >= extent[0]) & (longer <= extent[1]) & (shorter >= MIN_AXIS_RATIO * longer)
    found: list[Ellipse] = []
    for k in np.flatnonzero(likely):
        region = labels[y[k] : y[k] + h[k], x[k] : x[k] + w[k]] == k
        moments = cv2.moments(region.astype(np.uint8), binaryImage=True)
        n = moments["m00"]
        cx, cy = moments["m10"] / n, moments["m01"] / n
        # A pixel's own extent adds 1/12 px² to the moments that its centre gives.
        xx, yy, xy = moments["mu20"] / n + 1 / 12, moments["mu02"] / n + 1 / 12, moments["mu11"] / n
        fullness = n / (4.0 * np.pi * np.sqrt(max(xx * yy - xy * xy, 1e-9)))
        if not 0.85 <= fullness <= 1.1:
            continue
        middle = (factor - 1) / 2.0
        blob = ellipse_from_moments(
            (x[k] + cx) * factor + middle, (y[k] + cy) * factor + middle, *(m * factor**2 for m in (xx, xy, yy))
        )
        if blob is not None and blob.semi_minor_px >= MIN_AXIS_RATIO * blob.semi_major_px:
            found.append(blob)
    return found
