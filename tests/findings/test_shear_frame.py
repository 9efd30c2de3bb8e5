"""A shear frame: modes of a chain in closed form, motion between levels, and its fit to measured modes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.findings.shear_frame import (
    ShearFit,
    ShearFrame,
    ShearObservation,
    fit_shear_frame,
    interpolation,
    predicted,
    sensitivities,
)

FEW = settings(max_examples=20, deadline=None)
LEVELS_MM = np.array([100.0, 200.0, 300.0])
WEAK = ShearFrame(np.zeros(3), np.log(np.array([900.0, 600.0, 900.0])))
"""A frame whose middle storey is a third weaker."""


def observe(frame: ShearFrame, orders: int = 2) -> ShearObservation:
    """The lowest modes of a frame as ideal measurements at its levels."""
    log_omega, vectors = frame.modes()
    shapes = vectors[:, :orders].T
    return ShearObservation(
        np.arange(orders, dtype=float),
        log_omega[:orders],
        shapes,
        np.eye(len(frame.log_mass)),
        np.full(orders, 1e-4),
        np.full(shapes.shape, 1e-3),
    )


@pytest.mark.parametrize("levels", [1, 2, 3, 5])
def test_equal_storeys_have_the_closed_forms_frequencies(levels: int) -> None:
    frame = ShearFrame(np.zeros(levels), np.zeros(levels))
    order = np.arange(1, levels + 1)
    expected = 2 * np.sin((2 * order - 1) * np.pi / (2 * (2 * levels + 1)))
    assert np.exp(frame.modes()[0]) == pytest.approx(expected)


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_a_free_chain_has_no_rigid_mode_among_its_elastic_ones(levels: int) -> None:
    frame = ShearFrame(np.zeros(levels), np.zeros(levels - 1))
    log_omega, shapes = frame.modes()
    expected = 2 * np.sin(np.arange(1, levels) * np.pi / (2 * levels))
    assert not frame.is_fixed
    assert np.exp(log_omega) == pytest.approx(expected)
    assert np.abs(shapes.sum(axis=0)).max() < 1e-9  # of equal masses the centre stays where it is


@given(
    log_mass=st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
    log_stiffness=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    factor=st.floats(-2.0, 2.0),
)
@FEW
def test_shapes_are_orthogonal_and_a_common_factor_only_scales(
    log_mass: list[float], log_stiffness: list[float], factor: float
) -> None:
    frame = ShearFrame(np.array(log_mass), np.array(log_stiffness))
    log_omega, shapes = frame.modes()
    assert shapes.T @ np.diag(np.exp(frame.log_mass)) @ shapes == pytest.approx(np.eye(3), abs=1e-9)
    stiffer, same = ShearFrame(frame.log_mass, frame.log_stiffness + factor).modes()
    assert stiffer == pytest.approx(log_omega + factor / 2)
    assert np.abs(same) == pytest.approx(np.abs(shapes), abs=1e-6)


@given(height=st.floats(0.0, 300.0), clamped=st.booleans(), is_fixed=st.booleans())
@FEW
def test_weights_between_levels_are_shares(height: float, clamped: bool, is_fixed: bool) -> None:
    weights = interpolation(np.array([height]), LEVELS_MM, is_fixed=is_fixed, clamped=clamped)[0]
    assert np.all(weights >= 0)
    assert np.count_nonzero(weights) <= 2
    if not is_fixed or height >= LEVELS_MM[0]:
        assert weights.sum() == pytest.approx(1.0)  # below, the rest of it is the table's, which does not move


@pytest.mark.parametrize("clamped", [True, False])
def test_a_place_at_a_level_moves_with_it(clamped: bool) -> None:
    at = interpolation(LEVELS_MM, LEVELS_MM, is_fixed=True, clamped=clamped)
    assert at == pytest.approx(np.eye(3))
    foot = interpolation(np.array([0.0]), LEVELS_MM, is_fixed=True, clamped=clamped)
    assert foot == pytest.approx(np.zeros((1, 3)))


def test_a_clamped_column_leaves_its_floor_without_an_angle() -> None:
    near = interpolation(np.array([101.0]), LEVELS_MM, is_fixed=True, clamped=True)[0, 1]
    straight = interpolation(np.array([101.0]), LEVELS_MM, is_fixed=True, clamped=False)[0, 1]
    assert near < 0.05 * straight


def test_a_fit_finds_the_storey_that_is_weaker() -> None:
    fit = fit_shear_frame(observe(WEAK), 3, is_fixed=True)
    found = fit.frame.log_stiffness - fit.frame.log_stiffness.mean()
    meant = WEAK.log_stiffness - WEAK.log_stiffness.mean()
    assert int(np.argmin(found)) == 1
    assert np.all(np.abs(found - meant) < 3 * fit.sd_log_stiffness + 0.02)
    assert np.all(fit.sd_log_mass > 0)
    assert np.all(fit.sd_log_mass < 0.3)


def test_an_observation_of_more_modes_determines_stiffness_better() -> None:
    one, three = (fit_shear_frame(observe(WEAK, orders), 3, is_fixed=True) for orders in (1, 3))
    assert np.all(three.sd_log_stiffness < one.sd_log_stiffness)


def test_sensitivities_predict_the_change_of_a_stiffer_storey() -> None:
    observed = observe(WEAK)
    fit = ShearFit(WEAK, np.zeros(3), np.zeros(3))
    by_omega, by_shape = sensitivities(fit, observed)
    change = np.array([0.0, 0.01, 0.0])
    log_omega, _ = predicted(ShearFrame(WEAK.log_mass, WEAK.log_stiffness + change), observed)
    assert log_omega - observed.log_omega == pytest.approx(0.01 * by_omega[1], rel=0.02)
    assert by_shape.shape == (6, 2, 3)
    # All storeys stiffer together: each ln ω grows by half; all masses larger: it falls by half.
    assert by_omega[:3].sum(axis=0) == pytest.approx([0.5, 0.5], abs=1e-6)
    assert by_omega[3:].sum(axis=0) == pytest.approx([-0.5, -0.5], abs=1e-6)
