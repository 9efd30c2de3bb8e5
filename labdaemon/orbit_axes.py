"""Axes of an orbit ``d(t) = a sin ωt + b cos ωt``, with their covariances: one module for images and for space.

The same orbit has three descriptions, and this module converts between them:

- the conjugate vectors a and b, which depend on the origin of the phase;
- the second moment M = aaᵀ + bbᵀ, which does not, and which is all that whole cycles show;
- the principal semi-axes: the eigenvectors of M times the roots of its eigenvalues; the major one is the amplitude.

A semi-axis has no sign of its own: its largest component is reported as positive. `labdaemon.orbit_size` has the
amplitude alone, without numpy, for what reports it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def largest_sign(vector: FloatArray) -> float:
    """Sign that makes a vector's largest component positive."""
    return -1.0 if vector[np.argmax(np.abs(vector))] < 0 else 1.0


def orient_positive(vector: FloatArray) -> FloatArray:
    """The vector or its opposite, so that its largest component is positive."""
    result: FloatArray = largest_sign(vector) * vector
    return result


def principal_axes(a: FloatArray, b: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Turn any two conjugate vectors of an orbit into its major and minor semi-axes.

    ``a sin ωt + b cos ωt`` is the same path when the phase's origin is shifted by t, which turns (a, b) into
    (a cos t + b sin t, b cos t − a sin t). The axes are the pair at right angles.

    Parameters
    ----------
    a, b
        (d,) each.
    covariance
        (k + 2 d, k + 2 d) whose last 2 d rows belong to a and b; whatever comes before is carried along.

    Returns
    -------
    tuple
        Major and minor semi-axis, each with its largest component positive, and the covariance transformed.
    """
    dimension = len(a)
    difference, product = float(a @ a - b @ b), float(2.0 * a @ b)
    size = difference**2 + product**2
    turn = 0.5 * np.arctan2(product, difference)
    cos, sin = np.cos(turn), np.sin(turn)
    major, minor = cos * a + sin * b, cos * b - sin * a
    # d turn = (difference d product - product d difference) / (2 size); a circle has no axes, so no derivative.
    slope_a = (difference * 2.0 * b - product * 2.0 * a) / (2.0 * size) if size > 0 else np.zeros(dimension)
    slope_b = (difference * 2.0 * a + product * 2.0 * b) / (2.0 * size) if size > 0 else np.zeros(dimension)
    identity = np.eye(dimension)
    sign_major, sign_minor = largest_sign(major), largest_sign(minor)
    before = len(covariance) - 2 * dimension
    jacobian = np.eye(len(covariance))
    by_major = np.hstack([cos * identity + np.outer(minor, slope_a), sin * identity + np.outer(minor, slope_b)])
    by_minor = np.hstack([-sin * identity - np.outer(major, slope_a), cos * identity - np.outer(major, slope_b)])
    jacobian[before:, before:] = np.vstack([sign_major * by_major, sign_minor * by_minor])
    return sign_major * major, sign_minor * minor, jacobian @ covariance @ jacobian.T


def second_moment(a: FloatArray, b: FloatArray) -> FloatArray:
    """(xx, xy, yy) of ``a aᵀ + b bᵀ`` of an image path, px²."""
    return np.array([a[0] ** 2 + b[0] ** 2, a[0] * a[1] + b[0] * b[1], a[1] ** 2 + b[1] ** 2])


def second_moment_jacobian(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, 4) derivative of `second_moment` by (ax, ay, bx, by)."""
    return np.array(
        [
            [2.0 * a[0], 0.0, 2.0 * b[0], 0.0],
            [a[1], a[0], b[1], b[0]],
            [0.0, 2.0 * a[1], 0.0, 2.0 * b[1]],
        ]
    )


def second_moment_covariance(a: FloatArray, b: FloatArray, covariance: FloatArray) -> FloatArray:
    """(3, 3) covariance of `second_moment` from the (4, 4) one of (a, b), px⁴.

    Second-order terms (exact for normal errors, vector by vector) are included: for an axis of zero length they are
    all there is.
    """
    jacobian = second_moment_jacobian(a, b)
    result = jacobian @ covariance @ jacobian.T
    for part in (covariance[:2, :2], covariance[2:, 2:]):
        xx, xy, yy = part[0, 0], part[0, 1], part[1, 1]
        result = result + np.array(
            [
                [2 * xx * xx, 2 * xx * xy, 2 * xy * xy],
                [2 * xx * xy, xx * yy + xy * xy, 2 * xy * yy],
                [2 * xy * xy, 2 * xy * yy, 2 * yy * yy],
            ]
        )
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


def axes_from_moment(at: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(x, y, ax, ay, bx, by) and its covariance from (x, y, m0, m1, m2) and theirs."""
    return _propagate_covariance(lambda p: np.concatenate((p[:2], _semi_axes(moment_matrix(p[2:])))), at, covariance)


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
