"""Between second moments and the axes that are reported."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray


def orient_positive(vector: FloatArray) -> FloatArray:
    """The vector or its opposite, so that its largest component is positive."""
    largest = vector[int(np.argmax(np.abs(vector)))]
    result: FloatArray = -vector if largest < 0 else vector
    return result


def moment_matrix(moment: FloatArray) -> FloatArray:
    """(2, 2) from (m0, m1, m2)."""
    return np.array([[moment[0], moment[1]], [moment[1], moment[2]]])


def principal_moments(
    moment: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Principal values and directions of M = aaᵀ + bbᵀ with their covariance.

    Parameters
    ----------
    moment, covariance
        (3,) m0, m1, m2 (px²) and (3, 3).

    Returns
    -------
    values, major, minor, covariance
        (2,) larger first (px²); unit vectors (2,) each; (3, 3) covariance of (λ1, λ2, θ), θ the major axis' angle.
    """
    values, vectors = np.linalg.eigh(moment_matrix(moment))
    major, minor = orient_positive(vectors[:, 1]), orient_positive(vectors[:, 0])
    along = np.array([major[0] ** 2, 2 * major[0] * major[1], major[1] ** 2])
    across = np.array([minor[0] ** 2, 2 * minor[0] * minor[1], minor[1] ** 2])
    normal = np.array([-major[1], major[0]])
    gap = max(float(values[1] - values[0]), 1e-12)
    turn = np.array([major[0] * normal[0], major[0] * normal[1] + major[1] * normal[0], major[1] * normal[1]]) / gap
    jacobian = np.stack((along, across, turn))
    return values[::-1].copy(), major, minor, jacobian @ covariance @ jacobian.T


def _propagate_covariance(
    function: Callable[[FloatArray], FloatArray], at: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A function's value and the covariance that it inherits, by central differences."""
    value = function(at)
    jacobian = np.empty((len(value), len(at)))
    for column in range(len(at)):
        step = np.zeros(len(at))
        step[column] = 1e-5 * max(1.0, abs(at[column]))
        jacobian[:, column] = (function(at + step) - function(at - step)) / (2 * step[column])
    return value, jacobian @ covariance @ jacobian.T


def _semi_axes(moment: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(moment)
    values = np.sqrt(np.maximum(values, 1e-12))
    return np.concatenate((orient_positive(vectors[:, 1]) * values[1], orient_positive(vectors[:, 0]) * values[0]))


def axes_from_moment(at: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(x, y, ax, ay, bx, by) and its covariance from (x, y, m0, m1, m2) and theirs."""
    return _propagate_covariance(lambda p: np.concatenate((p[:2], _semi_axes(moment_matrix(p[2:])))), at, covariance)


def axes_from_vectors(at: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Centre, major axis, minor axis and covariance from (x, y, ax, ay, bx, by) with phase.

    The minor axis of a straight motion has no derivative; its standard deviation is taken from the vectors themselves.
    """

    def axes(p: FloatArray) -> FloatArray:
        return np.concatenate((p[:2], _semi_axes(np.outer(p[2:4], p[2:4]) + np.outer(p[4:], p[4:]))))

    value, cov = _propagate_covariance(axes, at, covariance)
    return value[:2], value[2:4], value[4:], cov
