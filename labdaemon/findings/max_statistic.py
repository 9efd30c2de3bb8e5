"""Many standardised differences, one false-alarm rate: the distribution of the largest of them, by simulation.

The statistics of one group (frequencies, shapes …) are correlated normal numbers without a change. Each group's largest
is compared with its own distribution, and the smallest of the groups' p-values with the distribution of that (minimum-p
method: Westfall and Young 1993, Resampling-Based Multiple Testing). So the rate holds over all targets, modes and
groups together, whatever their correlation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labdaemon.findings.response import FloatArray

DRAWS = 2000
LEVEL = 0.05
"""False-alarm rate: of two campaigns of an unchanged structure this part is called changed."""


@dataclass(frozen=True, slots=True, eq=False)
class MaxTest:
    """Outcome.

    Attributes
    ----------
    p_value
        Probability that an unchanged structure shows so much anywhere.
    z
        (n,) all standardised differences.
    critical
        (n,) what each would have to exceed, given its group, for the whole to be called changed.
    """

    p_value: float
    z: FloatArray
    critical: FloatArray

    @property
    def is_changed(self) -> bool:
        """Whether the p-value is below the level."""
        return self.p_value < LEVEL


def max_test(rows: FloatArray, values: FloatArray, covariance: FloatArray, groups: list[str], seed: int = 0) -> MaxTest:
    """Test linear functions (n, m) of a normal vector (m,) against mean 0.

    Parameters
    ----------
    groups
        (n,) name of each function's group.
    """
    if not len(rows):
        return MaxTest(1.0, np.zeros(0), np.zeros(0))
    scale, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(scale, 0.0))
    spread = rows @ root
    sd = np.linalg.norm(spread, axis=1)
    # A function that the nuisance parameters take wholly has no variance left, and no value but rounding.
    reference = np.linalg.norm(rows, axis=1) * np.sqrt(max(float(scale.max(initial=0.0)), 1e-300))
    is_seen = sd > 1e-9 * np.maximum(reference, 1e-300)
    z = np.where(is_seen, rows @ values / np.where(is_seen, sd, 1.0), 0.0)
    names = sorted(set(groups))
    label = np.array(groups)
    spread = np.where(is_seen[:, None], spread / np.where(is_seen, sd, 1.0)[:, None], 0.0)
    noise = np.random.default_rng(seed).normal(size=(root.shape[1], DRAWS))
    drawn = np.abs(spread @ noise)
    tops = np.array([np.sort(drawn[label == name].max(axis=0)) for name in names])
    unsorted = np.array([drawn[label == name].max(axis=0) for name in names])
    draw_p = np.array([_tail(top, values_) for top, values_ in zip(tops, unsorted, strict=True)]).min(axis=0)
    observed = np.array([np.abs(z[label == name]).max(initial=0.0) for name in names])
    own_p = np.array([_tail(top, np.array([one]))[0] for top, one in zip(tops, observed, strict=True)])
    p_value = float((1 + np.sum(draw_p <= own_p.min())) / (1 + DRAWS))
    # Far beyond all draws the tail of one normal number, times their count, is the smaller bound.
    p_value = min(p_value, float(len(z) * 2 * stats.norm.sf(np.abs(z).max())))
    limit_p = float(np.quantile(draw_p, LEVEL))
    limits = {name: float(np.quantile(top, 1 - limit_p)) for name, top in zip(names, tops, strict=True)}
    return MaxTest(min(p_value, 1.0), z, np.array([limits[name] for name in groups]))


def _tail(ordered: FloatArray, values: FloatArray) -> FloatArray:
    """Part of the draws that are at least as large."""
    above = len(ordered) - np.searchsorted(ordered, values, side="left")
    return np.asarray((1 + above) / (1 + len(ordered)), float)
