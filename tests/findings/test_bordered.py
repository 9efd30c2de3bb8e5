from __future__ import annotations

import numpy as np

from labdaemon.findings.bordered import BlockSystem

TARGETS, ROWS, LOCAL, SHARED = 3, 12, 2, 3


def _system(seed: int = 1) -> BlockSystem:
    rng = np.random.default_rng(seed)
    return BlockSystem(
        rng.normal(size=(TARGETS, ROWS, LOCAL)),
        rng.normal(size=(TARGETS, ROWS, SHARED)),
        rng.normal(size=(TARGETS, ROWS)),
        np.array([0.0, 4.0, 0.0]),
        np.array([0.0, 0.5, 0.0]),
    )


def _dense(system: BlockSystem) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and gradient of all parameters together: shared first."""
    size = SHARED + TARGETS * LOCAL
    jacobian = np.zeros((TARGETS * ROWS, size))
    for t in range(TARGETS):
        rows = slice(t * ROWS, (t + 1) * ROWS)
        jacobian[rows, :SHARED] = system.shared[t]
        jacobian[rows, SHARED + t * LOCAL : SHARED + (t + 1) * LOCAL] = system.local[t]
    normal = jacobian.T @ jacobian
    normal[:SHARED, :SHARED] += np.diag(system.prior_weight)
    gradient = jacobian.T @ system.residual.ravel()
    gradient[:SHARED] += system.prior_weight * system.prior_residual
    return normal, gradient


def test_step_equals_that_of_all_parameters_together() -> None:
    system = _system()
    normal, gradient = _dense(system)
    expected = np.linalg.solve(normal, gradient)
    shared, local = system.factorise().step(0.0)
    assert np.allclose(shared, expected[:SHARED])
    assert np.allclose(local.ravel(), expected[SHARED:])


def test_covariance_equals_the_inverse_of_the_whole() -> None:
    system = _system(2)
    expected = np.linalg.inv(_dense(system)[0])
    covariance = system.factorise().covariance()
    size = SHARED + TARGETS * LOCAL
    shared_rows, local_rows = np.zeros((size, SHARED)), np.zeros((size, TARGETS, LOCAL))
    shared_rows[:SHARED] = np.eye(SHARED)
    local_rows[SHARED:] = np.eye(TARGETS * LOCAL).reshape(-1, TARGETS, LOCAL)
    assert np.allclose(covariance.joint(shared_rows, local_rows), expected)
    assert np.allclose(covariance.local_block(1), expected[SHARED + LOCAL :, SHARED + LOCAL :][:LOCAL, :LOCAL])


def test_a_parameter_that_a_block_does_not_see_keeps_its_value() -> None:
    system = _system(3)
    system.local[1, :, 1] = 0.0
    shared, local = system.factorise().step(0.0)
    assert np.isfinite(shared).all()
    assert local[1, 1] == 0.0


def test_two_equal_columns_count_once() -> None:
    system = _system(4)
    system.local[0, :, 1] = system.local[0, :, 0]
    covariance = system.factorise().covariance()
    assert np.isfinite(covariance.own).all()
    assert covariance.own[0, 1, 1] == 0.0


def test_no_shared_parameters() -> None:
    system = _system(5)
    alone = BlockSystem(system.local, np.zeros((TARGETS, ROWS, 0)), system.residual, np.zeros(0), np.zeros(0))
    shared, local = alone.factorise().step(0.0)
    assert shared.shape == (0,)
    expected = np.linalg.lstsq(system.local[2], system.residual[2], rcond=None)[0]
    assert np.allclose(local[2], expected)
