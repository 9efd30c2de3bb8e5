from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labdaemon.bench.shear_structure import LEVELS_MM, Instrument, ShearStructure
from labdaemon.findings import ModalFit, find_modes, refit
from labdaemon.findings.comparison import Comparison, compare_states
from labdaemon.findings.modal_state import ModalState, pair_modes, state_of

STRUCTURE = ShearStructure(per_column=6)
NAMES = tuple(f"T{i:02d}" for i in range(12))


def design() -> np.ndarray:
    offsets = np.array([-2.0, -1.2, -0.6, 0.0, 0.6, 1.2, 2.0])
    around = [f * (1 + z * offsets) for f, z in zip(STRUCTURE.modes()[0], STRUCTURE.damping, strict=True)]
    return np.sort(np.concatenate([*around, [3.5, 10.0, 20.0, 33.0]]))


@pytest.fixture(scope="module")
def baseline() -> ModalFit:
    found = find_modes(Instrument().measure(STRUCTURE, design(), np.random.default_rng(0)))
    assert found.fit is not None
    assert len(found.modes) == 4
    return found.fit


def state(fitted: ModalFit) -> ModalState:
    return state_of(fitted, STRUCTURE.positions_mm(), NAMES)


def against(baseline: ModalFit, other: ShearStructure, seed: int = 1, level: float = 1.0, **how: bool) -> Comparison:
    series = Instrument().measure(other, design(), np.random.default_rng(seed), level)
    return compare_states(state(baseline), state(refit(baseline, series)), level_mm=np.array(LEVELS_MM), **how)


def test_an_unchanged_structure_is_not_called_changed(baseline: ModalFit) -> None:
    calls = [against(baseline, STRUCTURE, seed).changed for seed in range(12)]
    assert sum(calls) <= 3


@pytest.mark.parametrize("storey", range(4))
def test_half_a_per_cent_in_one_storey_is_that_storey(baseline: ModalFit, storey: int) -> None:
    found = against(baseline, STRUCTURE.with_stiffness(storey, 0.995))
    assert found.changed
    assert found.p_value < 1e-6
    assert found.storeys[0].where.startswith(f"storey {storey + 1}")
    assert found.storeys[0].change == pytest.approx(-0.005, abs=4 * found.storeys[0].sd)
    assert found.findings[0].what == "stiffness"


@pytest.mark.parametrize(
    ("other", "level", "what"),
    [
        (STRUCTURE.scaled(stiffness=0.99), 1.0, "uniform_stiffness_or_mass"),
        (STRUCTURE.scaled(mass=1.01), 1.0, "uniform_stiffness_or_mass"),
        (STRUCTURE, 0.7, ""),
        (replace(STRUCTURE, damping=tuple(1.1 * z for z in STRUCTURE.damping)), 1.0, "uniform_damping"),
    ],
)
def test_what_is_the_same_everywhere_is_no_damage(
    baseline: ModalFit, other: ShearStructure, level: float, what: str
) -> None:
    found = against(baseline, other, 3, level)
    assert not found.changed
    assert found.findings == ()
    assert found.storeys == ()
    assert not what or what in [one.what for one in found.explained_by]


def test_same_scale_counts_a_common_change(baseline: ModalFit) -> None:
    found = against(baseline, STRUCTURE.scaled(stiffness=0.99), same_scale=True)
    assert found.changed
    assert found.storeys[0].where.startswith("all storeys")
    assert found.storeys[0].change == pytest.approx(-0.01, rel=0.05)


def test_same_scale_finds_a_smaller_loss(baseline: ModalFit) -> None:
    found = against(baseline, STRUCTURE.with_stiffness(1, 0.998), same_scale=True)
    assert found.storeys[0].where.startswith("storey 2")


def test_mass_on_one_level(baseline: ModalFit) -> None:
    heavier = replace(STRUCTURE, mass_kg=(0.5, 0.5, 0.5, 0.51))
    found = against(baseline, heavier)
    assert found.storeys[0].kind == "mass"
    assert found.storeys[0].where.startswith("level 4")


def test_levels_from_the_targets(baseline: ModalFit) -> None:
    """Without the heights of the floors the change is placed between targets."""
    series = Instrument().measure(STRUCTURE.with_stiffness(0, 0.97), design(), np.random.default_rng(4))
    found = compare_states(state(baseline), state(refit(baseline, series)))
    assert found.changed
    assert found.storeys
    assert "mm" in found.storeys[0].where


def test_the_shear_frame_of_the_baseline(baseline: ModalFit) -> None:
    found = against(baseline, STRUCTURE)
    assert found.model is not None
    stiffness = found.model.fits[0].frame.log_stiffness
    assert np.exp(stiffness - stiffness.mean()) == pytest.approx([1.0] * 4, abs=0.02)
    assert np.all(found.model.fits[0].sd_log_stiffness < 0.05)


def test_nodes_and_mac_are_reported(baseline: ModalFit) -> None:
    found = against(baseline, STRUCTURE.with_stiffness(0, 0.9))
    assert len(found.modes) == 4
    assert all(one.mac.value > 0.9 for one in found.modes)
    assert min(one.mac.z for one in found.modes) < -5
    assert max(abs(node.z) for one in found.modes for node in one.node_shifts) > 5
    lowest = min(found.comac.values(), key=lambda one: one.z)
    assert lowest.value < 0.9999
    assert lowest.z < -5


def test_modes_of_one_state_alone_are_named(baseline: ModalFit) -> None:
    whole = state(baseline)
    part = whole.subset(np.array([0, 1, 3]), np.arange(12))
    assert pair_modes(part, whole) == [(0, 0), (1, 1), (2, 3)]
    found = compare_states(part, whole)
    assert "23.82 Hz is only in the other campaign" in found.notes[0]


def test_states_without_a_common_mode(baseline: ModalFit) -> None:
    whole = state(baseline)
    found = compare_states(whole.subset(np.array([0]), np.arange(12)), whole.subset(np.array([3]), np.arange(12)))
    assert not found.changed
    assert "nothing can be compared" in found.notes[-1]


def test_published_loss_of_a_quarter_in_one_storey(modal_data: Path) -> None:
    """The LANL frame: four masses on rails, the spring between masses 3 and 4 at 75 %."""
    content = json.loads((modal_data / "lanl_frame.json").read_text())
    heights = np.array([100.0, 200.0, 300.0, 400.0])
    states = []
    for name in ("baseline", "damaged"):
        one = content[name]
        shapes = np.zeros((3, 4, 3))
        shapes[:, :, 0] = np.array(one["shapes"]).T
        variance = np.concatenate([np.full(3, 1e-3**2), np.full(3, 0.05**2), np.full(36, 0.01**2)])
        positions = np.column_stack([np.zeros(4), np.zeros(4), heights])
        log_hz, log_damping = np.log(one["frequency_hz"]), np.log(one["damping"])
        states.append(ModalState(log_hz, log_damping, shapes, np.diag(variance), positions, ("1", "2", "3", "4")))
    found = compare_states(*states, level_mm=heights, is_fixed=False)
    assert found.changed
    stiffness = [one for one in found.storeys if one.kind == "stiffness"]
    assert found.storeys[0].where.startswith("storey 3 (300 to 400 mm)")
    assert stiffness[0].change < -0.1
