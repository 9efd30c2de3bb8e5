"""One orbit in three descriptions: conjugate vectors, second moment, semi-axes."""

import numpy as np
import pytest

from labdaemon.orbit_axes import (
    axes_from_moment,
    moment_matrix,
    orient_positive,
    principal_axes,
    principal_moments,
    second_moment,
    second_moment_jacobian,
)
from labdaemon.orbit_size import semi_axes, semi_major_axis


def orbits(seed=5, count=20):
    rng = np.random.default_rng(seed)
    return [(rng.normal(size=2), 0.6 * rng.normal(size=2)) for _ in range(count)]


def test_vectors_and_moment_give_the_same_axes():
    covariance = np.diag([1e-4, 1e-4, 4e-4, 5e-4, 3e-4, 2e-4])
    for a, b in orbits():
        major, minor, by_vectors = principal_axes(a, b, covariance)
        jacobian = np.eye(5, 6)
        jacobian[2:, 2:] = second_moment_jacobian(a, b)
        value, by_moment = axes_from_moment(
            np.concatenate((np.zeros(2), second_moment(a, b))), jacobian @ covariance @ jacobian.T
        )
        np.testing.assert_allclose(value[2:], np.concatenate((major, minor)), atol=1e-9)
        np.testing.assert_allclose(by_moment, by_vectors, atol=1e-7 + 1e-3 * np.abs(by_vectors).max())


def test_the_amplitude_is_the_same_with_and_without_numpy():
    for a, b in orbits():
        major, minor, _ = principal_axes(a, b, np.eye(4))
        assert np.linalg.norm(major) == pytest.approx(semi_major_axis(a.tolist(), b.tolist()), rel=1e-12)
        for own, other in zip((major, minor), semi_axes(a.tolist(), b.tolist()), strict=True):
            np.testing.assert_allclose(own, orient_positive(np.array(other)), atol=1e-12)


def test_squared_axes_are_the_eigenvalues_of_the_moment():
    a, b = np.array([3.0, -1.0]), np.array([0.2, 0.7])
    moment = second_moment(a, b)
    values, major, minor, covariance = principal_moments(moment, 1e-4 * np.eye(3))
    np.testing.assert_allclose(values, np.linalg.eigvalsh(moment_matrix(moment))[::-1])
    assert abs(major @ minor) < 1e-12
    assert np.all(np.diag(covariance) > 0)
