from __future__ import annotations

import numpy as np
import pytest

from labdaemon.findings.members import levels, members, targets_of_levels
from labdaemon.findings.mode_shape import (
    ModeShape,
    antinodes,
    curvature,
    mpc,
    mpc_value,
    nodes,
    section_motions,
    share_along,
)
from labdaemon.findings.propagation import propagate

HEIGHTS = np.linspace(60.0, 740.0, 9)
POSITIONS = np.array([(x, -100.0, z) for x in (-150.0, 150.0) for z in HEIGHTS])


def shape_of(twist: float = 0.0, sd: float = 0.002, imaginary: float | None = None) -> ModeShape:
    """Three quarter waves along X with torsion; noise with a common part."""
    wave = np.sin(1.5 * np.pi * POSITIONS[:, 2] / 760.0)
    vectors = np.zeros((len(POSITIONS), 3))
    vectors[:, 0] = wave * (1 - twist * POSITIONS[:, 1])
    vectors[:, 1] = wave * twist * POSITIONS[:, 0]
    values = vectors.ravel()
    if imaginary is not None:
        values = np.concatenate([values, imaginary * values[::-1]])
    covariance = sd**2 * (np.eye(len(values)) + 0.3 * np.outer(values, values))
    return ModeShape(values, covariance, POSITIONS, imaginary is not None)


def drawn(shape: ModeShape, count: int = 400) -> list[ModeShape]:
    noise = np.random.default_rng(1).multivariate_normal(np.zeros(len(shape.values)), shape.covariance, count)
    return [ModeShape(shape.values + one, shape.covariance, shape.positions_mm, shape.is_complex) for one in noise]


def test_members_and_levels() -> None:
    found = members(POSITIONS)
    assert [len(one) for one in found] == [9, 9]
    assert np.all(np.diff(POSITIONS[found[1], 2]) > 0)
    assert np.allclose(levels(POSITIONS), HEIGHTS)
    assert [len(one) for one in targets_of_levels(POSITIONS, HEIGHTS)] == [2] * 9
    assert members(POSITIONS[:2]) == []
    unknown = np.concatenate([POSITIONS, np.full((1, 3), np.nan), POSITIONS[:1] + np.array([20.0, 0.0, 0.4])])
    assert [one.tolist() for one in members(unknown)] == [one.tolist() for one in found], "no place, or the same height"


def test_nodes_by_delta_method_and_by_monte_carlo() -> None:
    shape = shape_of(sd=0.01)
    (left, right) = nodes(shape)
    assert left.height_mm == pytest.approx(2 / 3 * 760.0, abs=3.0)
    assert right.member == 1
    places = [nodes(one)[0].height_mm for one in drawn(shape)]
    assert np.std(places) == pytest.approx(left.sd_mm, rel=0.15)


def test_antinodes_by_delta_method_and_by_monte_carlo() -> None:
    shape = shape_of(sd=0.004)
    point = antinodes(shape)[0]
    assert point.height_mm == pytest.approx(760.0 / 3, abs=8.0)
    assert point.value == pytest.approx(1.0, abs=0.01)
    again = [antinodes(one)[0] for one in drawn(shape, 200)]
    assert np.std([one.height_mm for one in again]) == pytest.approx(point.sd_mm, rel=0.2)
    assert np.std([one.value for one in again]) == pytest.approx(point.sd_value, rel=0.2)


def test_curvature_by_delta_method_and_by_monte_carlo() -> None:
    shape = shape_of()
    member, height, value = curvature(shape)[3]
    wave = 1.5 * np.pi / 760.0
    assert member == 0
    assert value.value == pytest.approx(-(wave**2) * np.sin(wave * height), rel=0.03)
    again = [curvature(one)[3][2].value for one in drawn(shape, 200)]
    assert np.std(again) == pytest.approx(value.sd, rel=0.15)


def test_torsion_and_out_of_plane_part() -> None:
    twist = 8e-4
    shape = shape_of(twist)
    top = section_motions(shape)[-1]
    wave = np.sin(1.5 * np.pi * HEIGHTS[-1] / 760.0)
    assert top.torsion_per_mm.value == pytest.approx(wave * twist, abs=1e-9)
    again = [section_motions(one)[-1].torsion_per_mm.value for one in drawn(shape, 200)]
    assert np.std(again) == pytest.approx(top.torsion_per_mm.sd, rel=0.15)
    across = share_along(shape, 1)
    expected = (150 * twist) ** 2 / ((150 * twist) ** 2 + (1 + 100 * twist) ** 2)
    assert across.value == pytest.approx(expected, rel=1e-6)
    assert np.std([share_along(one, 1).value for one in drawn(shape, 60)]) == pytest.approx(across.sd, rel=0.3)


def test_mpc_of_real_and_complex_shapes() -> None:
    assert mpc(shape_of()).value == 1.0
    shape = shape_of(sd=0.01, imaginary=0.3)
    found = mpc(shape)
    assert 0.5 < found.value < 1.0
    values = [mpc_value(one.vectors.ravel()) for one in drawn(shape, 200)]
    assert np.std(values) == pytest.approx(found.sd, rel=0.2)
    turned = as_turned(shape)
    assert mpc(turned).value == pytest.approx(found.value)


def as_turned(shape: ModeShape) -> ModeShape:
    """The same shape with another phase: the collinearity does not change."""
    values = shape.vectors.ravel() * np.exp(0.7j)
    return ModeShape(np.concatenate([values.real, values.imag]), shape.covariance, POSITIONS, True)


def test_unit_scaling() -> None:
    shape = shape_of().unit_scaled()
    assert np.abs(shape.values).max() == pytest.approx(1.0)
    assert shape.direction() == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


def test_second_order_where_the_gradient_vanishes() -> None:
    """The square of a standard normal number has mean 1 and variance 2."""
    found = propagate(lambda x: float(x[0] ** 2 + 3 * x[0] * x[1]), np.zeros(2), np.eye(2), second_order=True)
    assert found.bias == pytest.approx(1.0)
    assert found.sd == pytest.approx(np.sqrt(2 + 9))
    assert found.z == 0.0
