"""MAC and COMAC of two states, each with its standard deviation and a z-score against an unchanged structure.

Both are squared cosines between two vectors: MAC between two shapes over all targets, COMAC between the displacements
of one coordinate in all modes, whose signs agree between the states. Two measurements of one structure give 1 minus a
small number Q, which noise alone makes: with unit vectors and the projection P across them Q = |P(δ₁ − δ₂)|², a
weighted sum of χ² variables whose weights λ are the eigenvalues of PCP. The z-score is the normal number with the same
probability, by the saddlepoint approximation (Kuonen 1999, doi:10.1093/biomet/86.4.929), which holds far out.

MAC: Allemang and Brown 1982 (IMAC 1, pages 110–116). COMAC: Lieven and Ewins 1988 (IMAC 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from labdaemon.findings.modal_state import ModalState
from labdaemon.findings.mode_shape import ModeShape, as_complex, mac_value
from labdaemon.findings.propagation import propagate
from labdaemon.findings.response import FloatArray

LEAST_PART = 0.1
"""Coordinates whose motion over all modes is smaller than this part of the largest are not compared by COMAC."""
NEGLIGIBLE, ROUNDING = 1e-9, 1e-12
"""Weights below this part of the largest, and values that rounding alone makes."""
LARGEST_SCORE = 1e3
"""Where there is a difference and no noise at all."""


@dataclass(frozen=True, slots=True)
class Assurance:
    """A criterion between 0 and 1.

    Attributes
    ----------
    value, sd
        As measured, and its standard deviation.
    expected
        Mean that noise alone leaves of 1.
    z
        Standard normal number of the same probability, if nothing had changed; negative where the vectors agree less
        than noise explains.
    """

    value: float
    sd: float
    expected: float
    z: float


def mac(one: ModeShape, other: ModeShape) -> Assurance:
    """Modal assurance criterion of two independent shapes."""
    return _compare(one.values, one.covariance, other.values, other.covariance, one.is_complex, other.is_complex)


def comac(first: ModalState, second: ModalState) -> dict[str, Assurance]:
    """COMAC of each target, of its direction with the lowest z-score; none of targets that hardly move.

    Parameters
    ----------
    first, second
        Two independent states with the same modes and targets in the same order, their signs aligned (`align_signs`).
    """
    modes, size = first.modes, first.shapes[0].size
    ones, others = (state.shapes.reshape(modes, -1) for state in (first, second))
    motion = np.linalg.norm(ones, axis=0)
    found: dict[str, Assurance] = {}
    for place in np.flatnonzero(motion > LEAST_PART * motion.max(initial=0.0)):
        rows = 2 * modes + size * np.arange(modes) + place
        spreads = [state.covariance[np.ix_(rows, rows)] for state in (first, second)]
        one = _compare(ones[:, place], spreads[0], others[:, place], spreads[1])
        name = first.targets[place // first.shapes.shape[2]]
        if name not in found or one.z < found[name].z:
            found[name] = one
    return found


def _compare(
    one: FloatArray,
    spread_one: FloatArray,
    other: FloatArray,
    spread_other: FloatArray,
    is_one_complex: bool = False,
    is_other_complex: bool = False,
) -> Assurance:
    size = len(one)
    both = np.concatenate([one, other])
    covariance = np.zeros((len(both), len(both)))
    covariance[:size, :size], covariance[size:, size:] = spread_one, spread_other

    def value(x: FloatArray) -> float:
        return mac_value(as_complex(x[:size], is_one_complex), as_complex(x[size:], is_other_complex))

    first = propagate(value, both, covariance)
    noise = _across(one, spread_one, is_one_complex) + _across(other, spread_other, is_other_complex)
    mean, square = float(np.trace(noise)), float(np.sum(noise**2))
    # Q = |d + ε|² has the variance 4dᵀCd + 2 tr C²; the first-order one is taken at d + ε, which adds 4 tr C² to it.
    sd = float(np.sqrt(max(first.sd**2 - 4 * square, 0.0) + 2 * square))
    weights = np.asarray(np.linalg.eigvalsh(noise), np.float64)
    return Assurance(first.value, sd, 1.0 - mean, -normal_score(1.0 - first.value, weights))


def _across(values: FloatArray, covariance: FloatArray, is_complex: bool) -> FloatArray:
    """Covariance of a unit vector across its direction; a complex one is free in phase, too."""
    length2 = max(float(values @ values), 1e-300)
    project = np.eye(len(values)) - np.outer(values, values) / length2
    if is_complex:
        half = len(values) // 2
        turned = np.concatenate([-values[half:], values[:half]])
        project = project - np.outer(turned, turned) / length2
    result: FloatArray = project @ covariance @ project / length2
    return result


def normal_score(value: float, weights: FloatArray) -> float:
    """Standard normal number with the same probability as a value of Σ λ χ²₁; positive above the median.

    Parameters
    ----------
    weights
        λ, (n,); rounding below zero is cut.
    """
    weights = weights[weights > NEGLIGIBLE * max(float(weights.max(initial=0.0)), 0.0)]
    if not weights.size:
        return 0.0 if value <= ROUNDING else LARGEST_SCORE
    mean, largest = float(weights.sum()), float(weights.max())
    value = max(value, NEGLIGIBLE * mean)

    def slope(at: float) -> float:
        return float(np.sum(weights / (1 - 2 * at * weights)) - value)

    # Between these the slope of the cumulant generating function takes the value.
    low, high = -len(weights) / (2 * value) - 1.0 / largest, max(0.0, (1 - largest / value) / (2 * largest))
    at = float(optimize.brentq(slope, low, high + 1e-12 / largest, xtol=1e-14 / largest)) if slope(high) > 0 else high
    rest = 1 - 2 * at * weights
    score = float(np.sign(at) * np.sqrt(max(2 * (at * value + 0.5 * np.sum(np.log(rest))), 0.0)))
    if abs(score) < 1e-3:  # at the mean the formula is 0/0; its limit is a sixth of the skewness
        return score + 8 * float(np.sum(weights**3)) / (6 * math.pow(2 * float(np.sum(weights**2)), 1.5))
    curvature = at * float(np.sqrt(2 * np.sum((weights / rest) ** 2)))
    return score + math.log(curvature / score) / score
