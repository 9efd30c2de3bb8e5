"""A shear frame as an explanation: one mass a level, one stiffness a storey, fitted to measured modes.

Levels move along one horizontal direction, storey i between levels i − 1 and i resists with stiffness k_i. Frequencies
and shapes determine all masses and stiffnesses up to a common factor; the total mass is therefore taken as 1, and the
masses are held near each other by a prior, because few modes say little of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares

from labdaemon.findings.response import FloatArray

MASS_PRIOR_SD = 0.3
"""Of the logarithm of a level's mass against the mean: levels of a frame are equal within a third."""
STIFFNESS_PRIOR_SD = 1.0
MODEL_SHAPE_SD = 0.03
"""Of a shape's component against the model, in units of the largest: columns also bend and stretch."""
MODEL_FREQUENCY_SD = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class ShearFrame:
    """Masses and stiffnesses of a chain.

    Attributes
    ----------
    log_mass
        (n,) of the levels, from the lowest up.
    log_stiffness
        (n,) of the storeys below each level; (n − 1,) between the levels of a frame that stands on nothing.
    """

    log_mass: FloatArray
    log_stiffness: FloatArray

    @property
    def is_fixed(self) -> bool:
        """Whether the lowest storey stands on the table."""
        return len(self.log_stiffness) == len(self.log_mass)

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Elastic modes: (r,) logarithms of their angular frequencies, (n, r) mass-normalised shapes."""
        k = np.exp(self.log_stiffness)
        chain = np.concatenate([k, [0.0]]) if self.is_fixed else np.concatenate([[0.0], k, [0.0]])
        stiffness = np.diag(chain[:-1] + chain[1:]) - np.diag(chain[1:-1], 1) - np.diag(chain[1:-1], -1)
        squares, vectors = eigh(stiffness, np.diag(np.exp(self.log_mass)))
        first = 0 if self.is_fixed else 1
        return 0.5 * np.log(np.maximum(squares[first:], 1e-300)), vectors[:, first:]


@dataclass(frozen=True, slots=True, eq=False)
class ShearObservation:
    """What a frame is fitted to.

    Attributes
    ----------
    orders
        (R,) which elastic mode each measured one is, from 0.
    log_omega
        (R,) logarithms of the angular frequencies.
    shapes
        (R, P) components along the direction of motion at P places.
    at_levels
        (P, n) displacement of each place per displacement of each level.
    sd_log_omega, sd_shapes
        Standard deviations.
    """

    orders: FloatArray
    log_omega: FloatArray
    shapes: FloatArray
    at_levels: FloatArray
    sd_log_omega: FloatArray
    sd_shapes: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ShearFit:
    """A fitted frame.

    Attributes
    ----------
    frame
        Best masses and stiffnesses; the total mass is 1.
    sd_log_mass, sd_log_stiffness
        Their relative standard deviations.
    """

    frame: ShearFrame
    sd_log_mass: FloatArray
    sd_log_stiffness: FloatArray


def interpolation(heights_mm: FloatArray, level_mm: FloatArray, *, is_fixed: bool, clamped: bool) -> FloatArray:
    """(P, n) motion of places on columns per motion of the levels.

    Parameters
    ----------
    is_fixed
        Whether the columns stand on the table at height 0, which does not move in this frame of reference.
    clamped
        Columns are clamped in the floors (a cubic between them); otherwise they are straight.
    """
    knots = np.concatenate([[0.0], level_mm]) if is_fixed else level_mm
    above = np.clip(np.searchsorted(knots, heights_mm), 1, len(knots) - 1)
    share = np.clip((heights_mm - knots[above - 1]) / (knots[above] - knots[above - 1]), 0.0, 1.0)
    share = share**2 * (3 - 2 * share) if clamped else share
    weights = np.zeros((len(heights_mm), len(knots)))
    weights[np.arange(len(heights_mm)), above - 1] = 1 - share
    weights[np.arange(len(heights_mm)), above] += share
    return weights[:, 1:] if is_fixed else weights


def fit_shear_frame(observed: ShearObservation, levels: int, *, is_fixed: bool) -> ShearFit:
    """Masses and stiffnesses that explain frequencies and shapes best."""
    storeys = levels if is_fixed else levels - 1
    start_frame = _frame(np.zeros(levels + storeys), levels)
    scale = float(np.mean(observed.log_omega - start_frame.modes()[0][observed.orders.astype(int)]))
    start = np.concatenate([np.zeros(levels), np.full(storeys, 2 * scale)])
    largest = np.abs(observed.shapes).max(axis=1, keepdims=True)
    sd_shape = np.hypot(observed.sd_shapes, MODEL_SHAPE_SD * largest)
    sd_omega = np.hypot(observed.sd_log_omega, MODEL_FREQUENCY_SD)

    def residuals(x: FloatArray) -> FloatArray:
        log_omega, shapes = predicted(_frame(x, levels), observed)
        size = np.sum(shapes * observed.shapes / sd_shape**2, axis=1) / np.sum(shapes**2 / sd_shape**2, axis=1)
        return np.concatenate(
            [
                (observed.log_omega - log_omega) / sd_omega,
                ((observed.shapes - size[:, None] * shapes) / sd_shape).ravel(),
                (x[:levels] - x[:levels].mean()) / MASS_PRIOR_SD,
                [x[:levels].mean() / 1e-3],
                (x[levels:] - x[levels:].mean()) / STIFFNESS_PRIOR_SD,
            ]
        )

    found = least_squares(residuals, start)
    jacobian: FloatArray = np.asarray(found.jac, np.float64)
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return ShearFit(_frame(found.x, levels), sd[:levels], sd[levels:])


def predicted(frame: ShearFrame, observed: ShearObservation) -> tuple[FloatArray, FloatArray]:
    """(R,) logarithms of angular frequencies and (R, P) shapes of the observed modes."""
    log_omega, vectors = frame.modes()
    orders = observed.orders.astype(int)
    return log_omega[orders], (observed.at_levels @ vectors[:, orders]).T


def sensitivities(fitted: ShearFit, observed: ShearObservation) -> tuple[FloatArray, FloatArray]:
    """Change of frequencies and shapes with each stiffness and mass.

    Returns
    -------
    log_omega, shapes
        (q, R) and (q, R, P) derivatives by the logarithm of each stiffness, then of each mass; shapes in the scale of
        the observed ones.
    """
    levels = len(fitted.frame.log_mass)
    x = np.concatenate([fitted.frame.log_mass, fitted.frame.log_stiffness])
    base = predicted(fitted.frame, observed)[1]
    size = np.sum(base * observed.shapes, axis=1) / np.sum(base**2, axis=1)
    order = [*range(levels, len(x)), *range(levels)]
    by_omega, by_shape, step = [], [], 1e-4
    for index in order:
        ends = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[index] += sign * step
            log_omega, shapes = predicted(_frame(moved, levels), observed)
            shapes = shapes * np.sign(np.sum(shapes * base, axis=1))[:, None]
            ends.append((log_omega, shapes * size[:, None]))
        by_omega.append((ends[0][0] - ends[1][0]) / (2 * step))
        by_shape.append((ends[0][1] - ends[1][1]) / (2 * step))
    return np.array(by_omega), np.array(by_shape)


def _frame(x: FloatArray, levels: int) -> ShearFrame:
    return ShearFrame(np.asarray(x[:levels], float), np.asarray(x[levels:], float))
