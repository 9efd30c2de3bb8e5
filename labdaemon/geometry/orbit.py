"""The shape of an orbit: its axes and second moment, with their covariances."""

from __future__ import annotations

import numpy as np

from labdaemon.geometry.motion import FloatArray


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


def largest_sign(vector: FloatArray) -> float:
    """Sign that makes a vector's largest component positive."""
    return -1.0 if vector[np.argmax(np.abs(vector))] < 0 else 1.0


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
