"""Least squares over points of an image, each with its own 2 × 2 covariance, and the search for gross errors.

A point whose residual is large against that residual's own standard deviation is left out (data snooping, both
coordinates together; Baarda 1968, A testing procedure for use in geodetic networks, Netherlands Geodetic Commission,
Publications on Geodesy 2(5)). A point that fits after all is taken back. The initial solution uses Cauchy's weights
(Holland and Welsch 1977, doi:10.1080/03610927708827533).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.settings import SNOOPING
from labdaemon.least_squares import cauchy_weight, damped_step, minimise, unit_scale

State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class PointEquations(Generic[State]):
    """Normal equations at one state: (m, m) matrix and (m,) gradient, with the cost there."""

    state: State
    cost: float
    normal: FloatArray
    gradient: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RobustPointAdjustment(Generic[State]):
    """A fit of some state to points.

    Attributes
    ----------
    linearise
        State -> (n, 2) residuals observed minus computed, (n, 2, 2) covariance of each observation, (n, 2, m)
        derivative of the computed values by the state's m parameters.
    move
        State and a change (m,) of its parameters -> state.
    prior
        (m,) weights (1/variance) that hold each parameter to where it starts when the state is its own parameter
        vector; None for none.
    """

    linearise: Callable[[State], tuple[FloatArray, FloatArray, FloatArray]]
    move: Callable[[State, FloatArray], State]
    prior: FloatArray | None = None

    def cost(self, state: State) -> float:
        """Robust sum of squares over all points."""
        return float(np.log1p(np.minimum(self.squares(state), 1e12) / SNOOPING.cauchy_scale2).sum())

    def squares(self, state: State) -> FloatArray:
        """(n,) squared residuals over their variance."""
        residuals, covariances, _ = self.linearise(state)
        return squared_normalised_residuals(residuals, covariances)

    def adjust(self, state: State, weights: FloatArray, *, robust: bool = False, steps: int = 50) -> State:
        """Levenberg–Marquardt; `robust` reweights by Cauchy's function on the way."""
        here = self._normal(state, weights, robust)
        if here is None:
            return state

        def try_step(here: PointEquations[State], damping: float) -> tuple[PointEquations[State] | None, bool]:
            step = damped_step(here.normal, here.gradient, damping)
            if not np.isfinite(step).all():
                return None, True  # the points say nothing more: what was reached stays
            is_small = float(step @ here.normal @ step) < 1e-16
            return self._normal(self.move(here.state, step), weights, robust), is_small

        return minimise(here, try_step, max_steps=steps).at.state

    def _normal(self, state: State, weights: FloatArray, robust: bool) -> PointEquations[State] | None:
        """Normal equations at a state; None when too few points can be seen."""
        residuals, covariances, jacobian = self.linearise(state)
        squares = squared_normalised_residuals(residuals, covariances)
        usable = np.isfinite(squares) & (weights > 0)
        if self.prior is None and 2 * usable.sum() < jacobian.shape[2]:
            return None
        lost = 1e6 * float((weights > 0).sum() - usable.sum())  # a point behind the camera is no improvement
        squares = squares[usable]
        weight = weights[usable] * (cauchy_weight(squares, SNOOPING.cauchy_scale2) if robust else 1.0)
        value = lost + float(
            np.sum(
                weights[usable]
                * (SNOOPING.cauchy_scale2 * np.log1p(squares / SNOOPING.cauchy_scale2) if robust else squares)
            )
        )
        whitened = np.linalg.solve(covariances[usable], jacobian[usable])
        normal = np.einsum("n,nij,nik->jk", weight, jacobian[usable], whitened)
        gradient = np.einsum("n,nij,ni->j", weight, whitened, residuals[usable])
        if self.prior is not None:
            normal = normal + np.diag(self.prior)
            gradient = gradient - self.prior * np.asarray(state)
            value += float(self.prior @ np.asarray(state) ** 2)
        return PointEquations(state, value, normal, gradient)

    def covariance(self, state: State, used: NDArray[np.bool_]) -> FloatArray:
        """(m, m) covariance of the parameters from the points in use.

        Raises
        ------
        DataError
            The points do not fix the parameters.
        """
        _, covariances, jacobian = self.linearise(state)
        jacobian = jacobian[used]
        normal = np.einsum("nij,nik->jk", jacobian, np.linalg.solve(covariances[used], jacobian))
        if self.prior is not None:
            normal = normal + np.diag(self.prior)
        scale = 1.0 / unit_scale(normal)
        scaled = normal * np.outer(scale, scale)
        if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1e13:
            raise DataError("the control targets do not fix the camera: they lie too close together or in a line")
        result: FloatArray = np.linalg.inv(scaled) * np.outer(scale, scale)
        return result

    def reject_outliers(self, state: State, min_points: int) -> tuple[State, NDArray[np.bool_]]:
        """Fit without gross errors.

        Parameters
        ----------
        state
            A robust solution to start from.
        min_points
            Number of points that must stay.

        Returns
        -------
        tuple
            The state, and (n,) bool: which points were used.
        """
        squares = self.squares(state)
        count = len(squares)
        limit = float(chi2.isf(SNOOPING.significance / count, 2))
        # Pixels worse than stated must not cost points one after the other: judge against the typical residual.
        scale = float(np.clip(np.median(squares) / chi2.median(2), 1.0, SNOOPING.max_scale))
        used: NDArray[np.bool_] = squares <= 10.0 * limit * scale
        if used.sum() < min_points:
            used = squares <= np.sort(squares)[min_points - 1]
        for _ in range(2 * count):
            state = self.adjust(state, used.astype(float))
            residuals, covariances, jacobian = self.linearise(state)
            spread = jacobian @ self.covariance(state, used) @ np.swapaxes(jacobian, 1, 2)
            # A used point has pulled the solution towards itself, an unused one has not.
            freed = covariances + np.where(used, -1.0, 1.0)[:, None, None] * spread
            floor = 1e-9 * np.trace(covariances, axis1=1, axis2=2)[:, None, None] * np.eye(2)
            tests = squared_normalised_residuals(residuals, freed + floor)
            wrong, fits = used & (tests > limit * scale), ~used & (tests <= limit * scale)
            used = used.copy()
            if fits.any():
                used[np.flatnonzero(fits)[np.argmin(tests[fits])]] = True
            elif wrong.any() and used.sum() > min_points:
                used[np.flatnonzero(wrong)[np.argmax(tests[wrong])]] = False
            else:
                break
        return state, used


def squared_normalised_residuals(residuals: FloatArray, covariances: FloatArray) -> FloatArray:
    """(n,) squared (n, 2) residuals over their (n, 2, 2) covariances; inf where a point cannot be seen."""
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    u, v = residuals[:, 0], residuals[:, 1]
    with np.errstate(all="ignore"):
        squares = (yy * u * u - 2.0 * xy * u * v + xx * v * v) / (xx * yy - xy * xy)
    return cast(FloatArray, np.where(np.isfinite(squares) & (squares >= 0), squares, np.inf))


def exclusion_reason(residual_px: FloatArray, square: float) -> str:
    """Say why a control target was left out."""
    return (
        f"residual ({residual_px[0]:+.2f}, {residual_px[1]:+.2f}) px is {np.sqrt(square):.0f} times its "
        "standard deviation: misread in the frame or mis-surveyed"
    )
