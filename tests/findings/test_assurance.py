from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labdaemon.findings.assurance import comac, mac, normal_score
from labdaemon.findings.modal_state import ModalState
from labdaemon.findings.mode_shape import ModeShape

POSITIONS = np.column_stack([np.zeros(8), np.zeros(8), np.linspace(100.0, 800.0, 8)])
NAMES = tuple(f"T{i}" for i in range(8))
WAVES = np.array([np.sin((k - 0.5) * np.pi * POSITIONS[:, 2] / 800.0) for k in (1, 2, 3)])


def drawn(rng: np.random.Generator, waves: np.ndarray = WAVES, sd: float = 0.01) -> ModalState:
    """A state of three modes along X whose shapes have correlated errors."""
    shapes = np.zeros((3, 8, 3))
    shapes[:, :, 0] = waves
    unit = np.zeros((78, 78))
    mixed = np.eye(72) + 0.4 * np.ones((72, 72))
    unit[6:, 6:] = sd**2 * mixed
    noise = rng.multivariate_normal(np.zeros(72), unit[6:, 6:], method="cholesky").reshape(3, 8, 3)
    return ModalState(np.zeros(3), np.zeros(3), shapes + noise, unit, POSITIONS, NAMES)


def shape_of(state: ModalState, mode: int = 1) -> ModeShape:
    part = slice(6 + 24 * mode, 30 + 24 * mode)
    return ModeShape(state.shapes[mode].ravel(), state.covariance[part, part], POSITIONS)


@pytest.fixture(scope="module")
def pairs() -> list[tuple[ModalState, ModalState]]:
    rng = np.random.default_rng(3)
    return [(drawn(rng), drawn(rng)) for _ in range(200)]


def test_mac_of_one_structure_is_lowered_by_noise_alone(pairs: list[tuple[ModalState, ModalState]]) -> None:
    found = [mac(shape_of(one), shape_of(other)) for one, other in pairs]
    values, z = np.array([one.value for one in found]), np.array([one.z for one in found])
    assert np.mean(values) - 1 == pytest.approx(found[0].expected - 1, rel=0.1)
    assert np.std(values) == pytest.approx(np.median([one.sd for one in found]), rel=0.3)
    assert np.mean(z) == pytest.approx(0.0, abs=0.2)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)


def test_comac_of_one_structure_has_normal_scores(pairs: list[tuple[ModalState, ModalState]]) -> None:
    """The lowest of three directions counts, of which one moves: Y and Z are below the limit."""
    z = np.array([[one.z for one in comac(*pair).values()] for pair in pairs])
    assert z.shape[1] == 8
    assert np.mean(z) == pytest.approx(0.0, abs=0.15)
    assert np.std(z) == pytest.approx(1.0, abs=0.15)
    assert np.mean(z < -1.645) == pytest.approx(0.05, abs=0.025)


def test_a_coordinate_that_changed_has_the_lowest_comac() -> None:
    rng = np.random.default_rng(4)
    other = WAVES.copy()
    other[1, 5] *= 0.7
    found = comac(drawn(rng), drawn(rng, other))
    lowest = min(found, key=lambda name: found[name].z)
    assert lowest == "T5"
    assert found["T5"].z < -4
    assert 0 < found["T5"].sd < 0.05
    changed = mac(shape_of(drawn(rng)), shape_of(drawn(rng, other)))
    assert changed.z < -2
    assert mac(shape_of(drawn(rng), 0), shape_of(drawn(rng, other), 0)).z > -4


def test_a_complex_shape_is_the_same_at_any_phase() -> None:
    values = np.concatenate([WAVES[0], 0.2 * WAVES[1]])
    turned = (WAVES[0] + 0.2j * WAVES[1]) * np.exp(0.9j)
    spread = 1e-4 * np.eye(16)
    one = ModeShape(values, spread, POSITIONS, is_complex=True)
    other = ModeShape(np.concatenate([turned.real, turned.imag]), spread, POSITIONS, is_complex=True)
    found = mac(one, other)
    assert found.value == pytest.approx(1.0)
    length2 = float(values @ values)
    assert found.expected == pytest.approx(1 - 2 * 14 * 1e-4 / length2)


def test_the_score_has_the_probability_of_a_weighted_sum() -> None:
    weights = np.array([1.0, 0.6, 0.3, 0.3, 0.1, 0.0])
    draws = np.random.default_rng(5).chisquare(1, (100_000, 6)) @ weights
    for part in (0.99, 0.9, 0.5, 0.1, 0.01):
        score = normal_score(float(np.quantile(draws, 1 - part)), weights)
        assert stats.norm.sf(score) == pytest.approx(part, rel=0.06)
    assert normal_score(float(weights.sum()), weights) == pytest.approx(
        normal_score(float(weights.sum()) * 1.01, weights), abs=0.02
    )


def test_the_score_far_out_is_that_of_one_chi_square() -> None:
    assert normal_score(400.0, np.array([1.0])) == pytest.approx(stats.norm.isf(stats.chi2.sf(400.0, 1)), rel=0.01)


def test_without_noise_any_difference_counts() -> None:
    assert normal_score(0.5, np.zeros(3)) > 100
    shape = ModeShape(WAVES[0], np.zeros((8, 8)), POSITIONS)
    same = mac(shape, shape)
    assert (same.value, same.sd, same.z) == (pytest.approx(1.0), 0.0, 0.0)
