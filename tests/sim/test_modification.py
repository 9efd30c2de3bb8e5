from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.cli.main import cli
from labdaemon.errors import UsageError
from labdrivers.sim.modification import MODIFICATIONS, Modification, modified_modes
from labdrivers.sim.server import _spec, start
from labdrivers.sim.structure import DEFAULT_MODES, HEIGHT_MM

FRONT = np.array([(x, -100.0, z) for x in (-150.0, 150.0) for z in np.linspace(95.0, HEIGHT_MM, 8)])


def frequencies(name: str) -> np.ndarray:
    return np.array([mode.frequency_hz for mode in modified_modes(MODIFICATIONS[name])])


def twist(name: str, mode: int) -> float:
    """Rotation of the top over its sway."""
    left, right = modified_modes(MODIFICATIONS[name])[mode].shape(FRONT[[7, 15]])
    return float(abs(right[1] - left[1]) / np.linalg.norm(left + right))


def test_the_unmodified_frame_is_the_default() -> None:
    assert modified_modes(MODIFICATIONS["none"]) == DEFAULT_MODES
    assert _spec(1, True).modes == DEFAULT_MODES


def test_mass_lowers_all_frequencies() -> None:
    change = frequencies("mass") / frequencies("none") - 1
    assert np.all(change < 0)
    assert np.all(change > -0.25)


def test_thinner_members_lower_them_further() -> None:
    assert np.all(frequencies("thinned") < frequencies("mass"))
    assert np.all(frequencies("thinned-only") < frequencies("none"))


def test_modifications_on_one_side_induce_torsion() -> None:
    assert twist("mass", 0) > 1.05 * twist("none", 0)


def test_a_modified_mode_stands_on_the_table() -> None:
    for mode in modified_modes(MODIFICATIONS["thinned"]):
        assert np.allclose(mode.shape(np.array([[10.0, 20.0, 0.0]]))[0, :2], 0.0)


def test_a_small_modification_is_a_small_change() -> None:
    small = modified_modes(Modification(mass_kg=1e-6))
    for mode, before in zip(small, DEFAULT_MODES, strict=True):
        assert mode.frequency_hz == pytest.approx(before.frequency_hz, rel=1e-4)
        largest = np.abs(before.shape(FRONT)).max()
        assert np.allclose(mode.shape(FRONT), before.shape(FRONT), atol=0.2 * largest)


def test_frequency_shift_is_first_order_right() -> None:
    """Rayleigh: a small mass m at a place changes ω² by the factor 1 − m·s²/(generalised mass)."""
    mass = 1e-4
    place = np.array([Modification().mass_mm])
    before, after = DEFAULT_MODES[0], modified_modes(Modification(mass_kg=mass))[0]
    corners = np.array([(x, y, z) for z in HEIGHT_MM * np.arange(1, 5) / 4 for x in (-150, 150) for y in (-100, 100)])
    generalised = 0.125 * np.sum(before.shape(corners.astype(float)) ** 2)
    expected = -0.5 * mass * np.sum(before.shape(place) ** 2) / generalised
    assert after.frequency_hz / before.frequency_hz - 1 == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("wrong", [Modification(member_loss=1.0), Modification(mass_kg=-1.0)])
def test_impossible_modifications_are_refused(wrong: Modification) -> None:
    with pytest.raises(ValueError, match="cannot be"):
        modified_modes(wrong)


def test_the_setting_reaches_the_rig() -> None:
    assert _spec(1, True, "mass").modes == modified_modes(MODIFICATIONS["mass"])


def test_a_rig_of_its_own_process_is_modified() -> None:
    with start(small=True, modification="thinned") as rig:
        assert rig.spec.modes == modified_modes(MODIFICATIONS["thinned"])
        assert rig.control.ask("records") == []


def test_a_demo_that_serves_is_not_modified(tmp_path: Path) -> None:
    command = ["demo", "--serve", "--modification", "mass", "--out", str(tmp_path / "demo")]
    result = CliRunner().invoke(cli, command)
    assert isinstance(result.exception, UsageError)
    assert "--modification" in str(result.exception)
    assert not (tmp_path / "demo").exists()
