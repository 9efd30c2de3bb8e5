"""The prior of motions in phase: most points of a structure move on lines, some on orbits of any ratio of their axes.

With r the ratio of a motion's axes, the prior density is

    (1 − s) · 2 N(r; 0, σ²)  +  s · U(r; 0, 1) ,

in which s is the share of orbits, and σ² is the square of the ratio τ of motions in phase plus the variance with which
r was measured. Before anything is known s and τ are those of the settings. Between two modes of different direction,
however, all points of a structure move on orbits of some per cent. Targets whose motion the rays and the images settle
without this prior say what s and τ are in their capture: `estimate_orbit_prior` counts them (EM of a mixture; Dempster,
Laird and Rubin 1977). A prior from the others of a group is what empirical Bayes estimates use (Robbins 1956).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdaemon.geometry.settings import INTERSECTION

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OrbitPrior:
    """The prior of a capture.

    Attributes
    ----------
    orbit_share
        s, share of motions that are orbits of any ratio of their axes.
    in_phase_ratio
        τ, standard deviation of the ratio of the others.
    """

    orbit_share: float = INTERSECTION.orbit_share
    in_phase_ratio: float = INTERSECTION.in_phase_ratio


UNKNOWN_CAPTURE = OrbitPrior()
"""Before anything of a capture is known."""


@dataclass(frozen=True, slots=True)
class AxisRatio:
    """Ratio of a motion's axes.

    Attributes
    ----------
    value
        Minor over major semi-axis.
    sd
        Its standard deviation.
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
        return cls(minor / major, float(np.sqrt(max(variance, 0.0)) / major))

    def straight_probability(self, prior: OrbitPrior) -> float:
        """Probability that the motion is in phase."""
        straight = (1 - prior.orbit_share) * self._density(prior, self.value)
        return straight / (straight + prior.orbit_share)

    def penalty(self, prior: OrbitPrior) -> float:
        """What the prior has against this ratio: twice the logarithm of the odds against a straight path."""
        return 2 * (self._log_prior(prior, 0.0) - self._log_prior(prior, self.value))

    def log_likelihood(self, prior: OrbitPrior) -> float:
        """Logarithm of the density of this ratio."""
        return self._log_prior(prior, self.value)

    def _log_prior(self, prior: OrbitPrior, value: float) -> float:
        return float(np.log((1 - prior.orbit_share) * self._density(prior, value) + prior.orbit_share))

    def _density(self, prior: OrbitPrior, value: float) -> float:
        """Density of a ratio among motions in phase; among orbits it is 1."""
        sd = float(np.hypot(self.sd, prior.in_phase_ratio))
        return float(np.sqrt(2 / np.pi) / sd * np.exp(-((value / sd) ** 2) / 2))


def estimate_orbit_prior(ratios: Sequence[AxisRatio]) -> OrbitPrior:
    """The prior by the targets of a capture.

    Parameters
    ----------
    ratios
        Of the targets that are settled without the prior.

    Returns
    -------
    OrbitPrior
        Of the ratios of motions in phase that are tried the one under which the targets are most probable, where the
        smallest counts as probable as it was beforehand; and the share of orbits with it.
    """
    tried = INTERSECTION.in_phase_ratio * np.array(INTERSECTION.in_phase_factors)
    priors = [OrbitPrior(_orbit_share(ratios, float(tau)), float(tau)) for tau in tried]
    return max(priors, key=lambda prior: _log_posterior(ratios, prior))


def _log_posterior(ratios: Sequence[AxisRatio], prior: OrbitPrior) -> float:
    """By the targets, by the share of orbits beforehand, and by the ratio of motions in phase beforehand."""
    count, share, s = INTERSECTION.orbit_share_targets, INTERSECTION.orbit_share, prior.orbit_share
    beforehand = count * (share * np.log(s) + (1 - share) * np.log(1 - s))
    beforehand -= INTERSECTION.in_phase_log_cost * np.log(prior.in_phase_ratio / INTERSECTION.in_phase_ratio)
    return float(sum(one.log_likelihood(prior) for one in ratios) + beforehand)


def _orbit_share(ratios: Sequence[AxisRatio], in_phase_ratio: float) -> float:
    """Share of orbits: the mean of the targets and of the prior, which counts as `orbit_share_targets` of them."""
    count = INTERSECTION.orbit_share_targets
    share = INTERSECTION.orbit_share
    for _ in range(INTERSECTION.orbit_share_steps):
        orbits = sum(1 - one.straight_probability(OrbitPrior(share, in_phase_ratio)) for one in ratios)
        share = (count * INTERSECTION.orbit_share + orbits) / (count + len(ratios))
    return float(share)
