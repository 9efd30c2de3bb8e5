"""Where a target is at rest in an image, and how probable a mean position of its motion is by that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DRIFTING_SHARE = 1e-5
"""Likelihood of a target that drifts alone, in parts of that of one at rest. Statistics: 1 % of them, over some 30 × 30
standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class RestPlace:
    """A place of rest.

    Attributes
    ----------
    place_px
        (2,) in this frame.
    variance_px2
        (2,) by which targets drift from it.
    """

    place_px: FloatArray
    variance_px2: FloatArray

    def excess(self, mean_px: FloatArray, covariance_px2: FloatArray) -> float:
        """What speaks against a mean position (2,) with its covariance (2, 2): twice the logarithm of the odds."""
        miss = mean_px - self.place_px
        distance2 = float(miss @ np.linalg.solve(covariance_px2 + np.diag(self.variance_px2), miss))
        return float(-2 * np.log((1 - DRIFTING_SHARE) * np.exp(-distance2 / 2) + DRIFTING_SHARE))
