"""The prior of motions in phase: most points of a structure move on lines, some on orbits of any ratio of their axes.

With r the ratio of a motion's axes, the prior density is

    (1 − s) · 2 N(r; 0, σ²)  +  s · U(r; 0, 1) ,

in which s is the share of orbits, and σ² is the square of `in_phase_ratio` plus the variance with which r was
measured. Before anything is known s is `orbit_share`. Targets whose motion the rays and the images settle without this
prior say what share it is in their capture: `estimate_orbit_share` counts them (EM of a mixture; Dempster, Laird and
Rubin 1977). A prior from the others of a group is what empirical Bayes estimates use (Robbins 1956).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdaemon.geometry.settings import INTERSECTION

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AxisRatio:
    """Ratio of a motion's axes.

    Attributes
    ----------
    value
        Minor over major semi-axis.
    sd
        Its standard deviation about zero, where the motion is in phase.
    """

    value: float
    sd: float

    @classmethod
    def of_motion(cls, motion_mm: FloatArray, covariance_mm2: FloatArray) -> AxisRatio | None:
        """Ratio of the axes of signed vectors.

        Parameters
        ----------
        motion_mm
            (3, 3): mean, a and b.
        covariance_mm2
            (9, 9).

        Returns
        -------
        AxisRatio
            None of a target at rest.
        """
        left, sizes, right = np.linalg.svd(motion_mm[1:].T, full_matrices=False)
        major, minor = float(sizes[0]), float(sizes[1])
        if major <= 0:
            return None
        # The minor axis changes by what is along it, a quarter of a cycle later than the major one.
        slope = np.kron(right[1], left[:, 1])
        variance = float(slope @ covariance_mm2[3:, 3:] @ slope)
        return cls(minor / major, float(np.hypot(np.sqrt(max(variance, 0.0)) / major, INTERSECTION.in_phase_ratio)))

    @property
    def peak(self) -> float:
        """Density of a straight path among motions in phase."""
        return float(np.sqrt(2 / np.pi) / self.sd)

    @property
    def density(self) -> float:
        """Density of this ratio among motions in phase; among orbits it is 1."""
        return self.peak * float(np.exp(-((self.value / self.sd) ** 2) / 2))

    def straight_probability(self, orbit_share: float) -> float:
        """Probability that the motion is in phase."""
        straight = (1 - orbit_share) * self.density
        return straight / (straight + orbit_share)

    def penalty(self, orbit_share: float) -> float:
        """What the prior has against this ratio: twice the logarithm of the odds against a straight path."""
        straight = 1 - orbit_share
        return float(2 * np.log((straight * self.peak + orbit_share) / (straight * self.density + orbit_share)))


def estimate_orbit_share(ratios: Sequence[AxisRatio]) -> float:
    """Share of orbits among the targets of a capture.

    Parameters
    ----------
    ratios
        Of the targets that are settled without the prior.

    Returns
    -------
    float
        The mean of the targets and of the prior, which counts as `orbit_share_targets` of them.
    """
    count = INTERSECTION.orbit_share_targets
    share = INTERSECTION.orbit_share
    for _ in range(INTERSECTION.orbit_share_steps):
        orbits = sum(1 - one.straight_probability(share) for one in ratios)
        share = (count * INTERSECTION.orbit_share + orbits) / (count + len(ratios))
    return float(share)
