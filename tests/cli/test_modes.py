from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.bench.campaign_folder import write_campaign
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.cli.main import cli
from labdaemon.errors import DataError
from labdaemon.findings import PhaseReference

STRUCTURE = ShearStructure(per_column=5)
NAMES = tuple(f"{side}{i + 1:02d}" for side in "LR" for i in range(5))


def write(folder: Path, frequency: np.ndarray) -> Path:
    series = Instrument().measure(STRUCTURE, frequency, np.random.default_rng(1))
    return write_campaign(folder, replace(series, targets=NAMES), STRUCTURE.positions_mm())


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("modes") / "a", np.geomspace(4.0, 18.0, 26))


def test_modes_of_a_sweep(campaign: Path) -> None:
    result = CliRunner().invoke(cli, ["modes", str(campaign), "--json"], catch_exceptions=False)
    found = json.loads(result.stdout)
    natural = STRUCTURE.modes()[0][:2]
    assert [one["frequency_hz"] for one in found["modes"]] == pytest.approx(natural, rel=5e-4)
    first, second = found["modes"]
    assert first["nodes"] == []
    assert len(second["nodes"]) == 2, "one on each column"
    assert second["nodes"][0]["sd_mm"] < 2.0
    assert set(first["shape"]) == set(NAMES)
    top = first["shape"]["L05"]
    expected = STRUCTURE.residues()[4, 0, 0]
    assert abs(top["value"][0]) == pytest.approx(expected, abs=0.01)
    assert first["mpc"] == {"value": 1.0, "sd": 0.0, "bias": 0.0}
    assert len(first["sections"]) == 5
    assert first["sections"][-1]["sway_x"]["value"] == pytest.approx(
        np.mean([first["shape"][name]["value"][0] for name in ("L05", "R05")])
    )
    assert all(one["sd"] > 0 for one in second["curvature"])
    assert "participation factor" in found["scaling"]
    assert first["out_of_plane"]["value"] < 1e-3
    assert abs(first["torsion_per_mm"]["value"]) < 5 * first["torsion_per_mm"]["sd"]
    assert 4.0 <= found["next_hz"] <= 18.0
    ratio = found["transmissibility"]
    assert len(ratio["frequency_hz"]) == len(ratio["targets"]["L05"]["value"]) == 26
    assert max(ratio["targets"]["L05"]["value"]) > 20


def test_a_target_that_was_never_found_is_left_out(campaign: Path, tmp_path: Path) -> None:
    """It has no place; the search for columns once went on for ever."""
    other = shutil.copytree(campaign, tmp_path / "hidden")
    path = other / "results" / "envelope.csv"
    header, *lines = path.read_text().splitlines()
    behind = len(header.split(",flags,")[1].split(","))
    lost = [f"{line[:8]}{',' * 20}not_found{',' * behind}" if line[5:8] == "L02" else line for line in lines]
    path.write_text("\n".join([header, *lost]) + "\n")
    result = CliRunner().invoke(cli, ["modes", str(other), "--json"], catch_exceptions=False)
    found = json.loads(result.stdout)
    assert len(found["modes"]) == 2
    assert set(found["modes"][0]["shape"]) == set(NAMES) - {"L02"}
    assert "hidden: never measured without a flag, and left out: L02" in found["notes"]


def test_text(campaign: Path) -> None:
    result = CliRunner().invoke(cli, ["modes", str(campaign)], catch_exceptions=False)
    assert result.exit_code == 0
    assert "5.39" in result.output
    assert "nodes at none" in result.output
    assert "the next step" in result.output
    assert "times as far as the table at 5.4" in result.output


def test_no_mode_is_said(tmp_path: Path) -> None:
    folder = write(tmp_path / "b", np.array([5.0, 8.0, 12.0]))
    result = CliRunner().invoke(cli, ["modes", str(folder)], catch_exceptions=False)
    assert result.output.startswith("no mode\n")
    assert "note: 3 steps with results: at least 5 are needed" in result.output


def test_a_folder_without_results(tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["modes", str(tmp_path)])
    assert isinstance(result.exception, DataError)
    assert result.exception.exit_status == 2


def test_coded_light_gives_complex_shapes(tmp_path: Path) -> None:
    """All captures show phase, and a gauge on the table its own: a lag of 0.2 rad of the drive is taken out."""
    frequency = np.geomspace(4.0, 18.0, 26)
    series = Instrument(phase=PhaseReference.TABLE).measure(STRUCTURE, frequency, np.random.default_rng(1))
    lagging = replace(series, targets=NAMES, amplitude=series.amplitude * np.exp(-0.2j))
    folder = write_campaign(tmp_path / "c", lagging, STRUCTURE.positions_mm())
    for path in folder.glob("captures/*/capture.toml"):
        amplitude = float(path.read_text().split("excitation_amplitude_mm = ")[1].split()[0])
        gauge = f"amplitude_mm = {amplitude}\nsd_amplitude_mm = {0.002 * amplitude}\n"
        gauge += "phase_rad = -0.2\nsd_phase_rad = 0.005\n"
        path.write_text(path.read_text() + '\n[gauges.bed]\nrole = "table"\n' + gauge)
    result = CliRunner().invoke(cli, ["modes", str(folder), "--json"], catch_exceptions=False)
    first = json.loads(result.stdout)["modes"][0]
    assert first["frequency_hz"] == pytest.approx(STRUCTURE.modes()[0][0], rel=5e-4)
    assert first["shape"]["L05"]["value"][0] == pytest.approx(STRUCTURE.residues()[4, 0, 0], abs=0.01)
    assert abs(first["shape"]["L05"]["imag"][0]) < 5 * first["shape"]["L05"]["sd_imag"][0]
    assert 1 - first["mpc"]["value"] < 5 * first["mpc"]["sd"] + 1e-6
