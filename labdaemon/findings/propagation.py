"""Standard deviations of functions of uncertain numbers, to second order.

With the gradient g and the Hessian H of a function at the estimate, and normal errors of covariance C, its variance is
gᵀCg + ½·tr(HCHC) and its mean is larger than the estimate's true value by ½·tr(HC). The second-order terms matter where
the gradient vanishes, as that of the MAC of two equal shapes does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from labdaemon.findings.response import FloatArray

RELATIVE_STEP = 0.05
"""Of a difference, in units of the standard deviation: small against the scale on which errors move the function."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its standard deviation.

    Attributes
    ----------
    value, sd
        Estimate at the given numbers, and its sd.
    bias
        By how much noise raises the value on average.
    """

    value: float
    sd: float
    bias: float = 0.0

    @property
    def z(self) -> float:
        """Value over sd; 0 where both vanish."""
        return self.value / self.sd if self.sd > 0 else 0.0


def propagate_linear(rows: FloatArray, values: FloatArray, covariance: FloatArray) -> list[Estimate]:
    """Estimates of linear functions (q, n)."""
    sd = np.sqrt(np.maximum(np.einsum("qn,nm,qm->q", rows, covariance, rows, optimize=True), 0.0))
    return [Estimate(float(value), float(one)) for value, one in zip(rows @ values, sd, strict=True)]


def propagate(
    function: Callable[[FloatArray], float], values: FloatArray, covariance: FloatArray, *, second_order: bool = False
) -> Estimate:
    """Estimate of a function of numbers (n,) with a covariance (n, n).

    Parameters
    ----------
    second_order
        Add the Hessian's terms; this takes of the order of n² evaluations.
    """
    scale, vectors = np.linalg.eigh(covariance)
    keep = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    # In independent directions of unit variance only those that vary need differences.
    root = vectors[:, keep] * np.sqrt(scale[keep])
    count, step = root.shape[1], RELATIVE_STEP

    def at(direction: FloatArray) -> float:
        return function(values + root @ direction)

    centre, unit = at(np.zeros(count)), np.eye(count) * step
    plus, minus = np.array([at(one) for one in unit]), np.array([at(-one) for one in unit])
    gradient = (plus - minus) / (2 * step)
    variance, bias = float(gradient @ gradient), 0.0
    if second_order:
        hessian = np.diag((plus - 2 * centre + minus) / step**2)
        for i in range(count):
            for j in range(i):
                both = at(unit[i] + unit[j])
                hessian[i, j] = hessian[j, i] = (both - plus[i] - plus[j] + centre) / step**2
        variance += 0.5 * float(np.sum(hessian**2))
        bias = 0.5 * float(np.trace(hessian))
    return Estimate(centre, float(np.sqrt(max(variance, 0.0))), bias)
