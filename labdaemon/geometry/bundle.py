"""Bundle adjustment: cameras, points and what is known of them, all in one least-squares solution with covariance.

Observations are pixels, surveyed coordinates with weights, and distances; or, in a free network, inner constraints
take the place of control. Cameras may be given in OpenCV's forward model or in Brown's backward one, with any of their
interior parameters among the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.network import Network, check_network
from labdaemon.geometry.normal_equations import LinearisedNetwork, NormalEquations, apply_change, form_normal, linearise
from labdaemon.least_squares import DampingRule, minimise

_CHUNK = 4000  # observations or points whose dense rows are held at once


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Result of a bundle adjustment.

    Attributes
    ----------
    network
        The same observations with adjusted lenses, poses and points.
    residuals_px
        (n, 2) of the observations.
    survey_residuals
        (p, 3) surveyed minus adjusted coordinates, 0 where nothing was known.
    sigma0
        Standard deviation of unit weight, a posteriori; with `sd_px` = 1 it is in pixels.
    degrees_of_freedom
        Observations and constraints less unknowns.
    unknowns, observations
        Their numbers.
    iterations
        Steps until the solution stood still.
    cofactor
        (k, k) covariance of the camera unknowns for unit weight: free interior parameters lens by lens, then six
        exterior parameters an image (rotation vector in camera axes, position).
    """

    network: Network
    residuals_px: FloatArray
    survey_residuals: FloatArray
    sigma0: float
    degrees_of_freedom: int
    unknowns: int
    observations: int
    iterations: int
    cofactor: FloatArray
    _linear: LinearisedNetwork
    _normal: NormalEquations
    _inverse: FloatArray

    @property
    def interior_count(self) -> int:
        """Number of interior unknowns, which come first in `cofactor`."""
        return sum(len(columns) for columns in self.network.interior_columns)

    def interior_sd(self, lens: int = 0, *, scaled: bool = True) -> FloatArray:
        """(9,) standard deviations of a lens's parameters, 0 for those held; by sigma0 when `scaled`."""
        columns = self.network.interior_columns
        offset = sum(len(c) for c in columns[:lens])
        result = np.zeros(9)
        result[columns[lens]] = np.sqrt(np.diag(self.cofactor)[offset : offset + len(columns[lens])])
        return result * (self.sigma0 if scaled else 1.0)

    def exterior_covariance(self, *, scaled: bool = True) -> FloatArray:
        """(6 m, 6 m) joint covariance of all images' exterior parameters."""
        start = self.interior_count
        return self.cofactor[start:, start:] * (self.sigma0**2 if scaled else 1.0)

    def point_covariance(self, *, scaled: bool = True) -> FloatArray:
        """(p, 3, 3) covariance of each point."""
        points, size = len(self.network.points), self._inverse.shape[0]
        result = self._normal.inverse_v.copy()
        for start in range(0, points, _CHUNK):
            stop = min(start + _CHUNK, points)
            rows = self._normal.transfer[3 * start : 3 * stop].toarray().reshape(stop - start, 3, size)
            result[start:stop] += np.einsum("pik,pjk->pij", rows @ self._inverse, rows)
        return result * (self.sigma0**2 if scaled else 1.0)

    def fitted_cofactor(self) -> FloatArray:
        """(n, 2, 2) covariance of each observation's computed pixel for unit weight.

        What is left of the observation's own variance after subtracting it is its residual's; their ratio is the
        observation's redundancy.
        """
        network, linear = self.network, self._linear
        count, size = len(network.image), self._inverse.shape[0]
        by_point = linear.by_point
        result = by_point @ self._normal.inverse_v[network.point] @ np.swapaxes(by_point, 1, 2)
        width = linear.by_camera.shape[1]
        for start in range(0, count, _CHUNK):
            stop = min(start + _CHUNK, count)
            rows = np.zeros((2 * (stop - start), size))
            rows[:, :width] = linear.by_camera[2 * start : 2 * stop].toarray()
            places = np.repeat(3 * network.point[start:stop, None] + np.arange(3), 2, axis=0).ravel()
            block = sparse.csr_matrix(
                (by_point[start:stop].ravel(), (np.repeat(np.arange(len(rows)), 3), places)),
                shape=(len(rows), 3 * len(network.points)),
            )
            rows -= (block @ self._normal.transfer).toarray()
            pairs = rows.reshape(-1, 2, size)
            result[start:stop] += np.einsum("nik,njk->nij", pairs @ self._inverse, pairs)
        return result


DAMPING = DampingRule(start=1e-4, relaxed=0.05, raised=20.0, most=1e8)
"""A network of many cameras starts further off than a single one, and a step costs more: λ moves in longer strides."""


@dataclass(frozen=True, slots=True, eq=False)
class _AdjustedNetwork:
    """A network, linearised there, with its weighted sum of squares."""

    network: Network
    linear: LinearisedNetwork
    cost: float


def adjust_network(network: Network, *, names: Sequence[str] | None = None, max_steps: int = 60) -> Adjustment:
    """Adjust a network by Levenberg–Marquardt to the last digit.

    Parameters
    ----------
    network
        Observations and starting values (`labdaemon.geometry.network`).
    names
        (p,) names of the points for messages; their numbers by default.
    max_steps
        Give up after so many.

    Returns
    -------
    Adjustment

    Raises
    ------
    DataError
        The network cannot be adjusted (a point seen once, no datum), does not converge, or leaves unknowns
        undetermined.
    """
    names = [str(i) for i in range(len(network.points))] if names is None else names
    check_network(network, names)
    surveyed = network.points.copy()
    linear = linearise(network, surveyed)
    cost = linear.cost(network)
    if not np.isfinite(cost):
        raise DataError("the starting values put points behind a camera or outside its lens model")

    def try_step(here: _AdjustedNetwork, damping: float) -> tuple[_AdjustedNetwork, bool]:
        trial = apply_change(here.network, *form_normal(here.network, here.linear, damping).solve())
        linear = linearise(trial, surveyed)
        there = _AdjustedNetwork(trial, linear, linear.cost(trial))
        # A last gain of 1e-10 is a change of the unknowns by a hundred-thousandth of their standard deviation.
        gain = abs(here.cost - there.cost)
        return there, damping <= 1e-3 and gain <= 1e-10 * here.cost + 1e-14 * len(trial.image)

    minimum = minimise(_AdjustedNetwork(network, linear, cost), try_step, rule=DAMPING, max_steps=max_steps)
    steps = minimum.steps
    if not minimum.converged:
        raise DataError(f"the adjustment did not converge in {steps} steps: check the starting values and identities")
    network, linear, cost = minimum.at.network, minimum.at.linear, minimum.at.cost
    normal = form_normal(network, linear)
    inverse = normal.cofactor()
    cameras_count = linear.by_camera.shape[1]
    known = (network.survey_sd > 0) & np.isfinite(network.survey_sd)
    observations = 2 * len(network.image) + int(known.sum()) + len(network.bars)
    unknowns = cameras_count + int((network.survey_sd > 0).sum())
    freedom = observations + (len(linear.extra_diagonal) - len(network.bars)) - unknowns
    if freedom < 0:
        raise DataError(f"{observations} observations for {unknowns} unknowns: more images or control are needed")
    return Adjustment(
        network,
        linear.residuals,
        linear.survey,
        float(np.sqrt(cost / freedom)) if freedom else float("nan"),
        freedom,
        unknowns,
        observations,
        steps,
        inverse[:cameras_count, :cameras_count],
        linear,
        normal,
        inverse,
    )
