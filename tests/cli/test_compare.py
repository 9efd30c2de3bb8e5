from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from labdaemon.bench.campaign_folder import write_campaign
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.cli.main import cli
from labdaemon.errors import ConfigError, DataError, LabdaemonError, UsageError
from labdaemon.findings import PhaseReference
from labdaemon.processing import ENVELOPE_COLUMNS

STRUCTURE = ShearStructure(per_column=4)
NAMES = tuple(f"{side}{i + 1:02d}" for side in "LR" for i in range(4))
SWEEP = np.sort(
    np.concatenate(
        [f * (1 + 0.01 * np.array([-2, -1, -0.4, 0.4, 1, 2])) for f in STRUCTURE.modes()[0][:3]]
        + [np.array([3.5, 9.0, 20.0, 27.0])]
    )
)
DWELLS = np.array([5.0, 8.0, 12.0])


@pytest.fixture
def campaign(tmp_path: Path) -> Callable[..., Path]:
    def make(
        name: str,
        structure: ShearStructure = STRUCTURE,
        frequency: np.ndarray = SWEEP,
        seed: int = 1,
        phase: PhaseReference = PhaseReference.TARGET,
        names: tuple[str, ...] = NAMES,
        **how: Any,
    ) -> Path:
        series = Instrument(phase=phase).measure(structure, frequency, np.random.default_rng(seed))
        return write_campaign(tmp_path / name, replace(series, targets=names), structure.positions_mm(), **how)

    return make


HEADER = ",".join(ENVELOPE_COLUMNS)


def edit(folder: Path, change: Callable[[dict[str, str]], dict[str, str]]) -> None:
    """Change every row of `envelope.csv`; what `change` leaves out is the row's end."""
    path = folder / "results" / "envelope.csv"
    with path.open(newline="") as file:
        rows = [change(row) for row in csv.DictReader(file)]
    path.write_text("\n".join([HEADER, *(",".join(row.values()) for row in rows if row)]) + "\n")


def compare(*arguments: object) -> dict[str, Any]:
    result = CliRunner().invoke(cli, ["compare", *map(str, arguments), "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    content: dict[str, Any] = json.loads(result.stdout)
    return content


def refused(*arguments: object) -> LabdaemonError:
    result = CliRunner().invoke(cli, ["compare", *map(str, arguments), "--json"])
    assert isinstance(result.exception, LabdaemonError), result.output
    assert result.exception.exit_status == 2
    return result.exception


def test_unchanged(campaign: Callable[..., Path]) -> None:
    found = compare(campaign("a"), campaign("b", seed=2))
    assert found["changed"] is False
    assert 0.05 <= found["p_value"] <= 1
    assert found["findings"] == []
    assert isinstance(found["explained_by"], list)
    assert len(found["modes"]) == 3


def test_loss_in_one_storey(campaign: Callable[..., Path]) -> None:
    other = campaign("b", STRUCTURE.with_stiffness(2, 0.98), seed=2)
    found = compare(campaign("a"), other, "--levels-mm", "190,380,570,760")
    assert found["changed"] is True
    assert found["findings"][0]["where"].startswith("storey 3")
    assert found["findings"][0]["z"] < -5
    assert found["shear_frame"][0]["sd_stiffness"]


def test_text_says_the_same(campaign: Callable[..., Path]) -> None:
    other = campaign("b", STRUCTURE.with_stiffness(2, 0.98).scaled(stiffness=0.99), seed=2)
    command = ["compare", str(campaign("a")), str(other), "--levels-mm", "190,380,570,760"]
    result = CliRunner().invoke(cli, command, catch_exceptions=False)
    assert result.exit_code == 0
    assert result.output.startswith("changed (p = ")
    assert "stiffness of storey 3" in result.output
    assert "explained: all natural frequencies changed by -0." in result.output


def test_temperature_is_explained(campaign: Callable[..., Path]) -> None:
    first, other = campaign("a"), campaign("b", STRUCTURE.scaled(stiffness=0.99), seed=2)
    found = compare(first, other)
    assert found["changed"] is False
    assert "uniform_stiffness_or_mass" in [one["what"] for one in found["explained_by"]]
    assert compare(first, other, "--same-scale")["changed"] is True


def test_moved_cameras_are_explained(campaign: Callable[..., Path]) -> None:
    angle = np.radians(3.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    found = compare(campaign("a"), campaign("b", seed=2, rotation=turn))
    assert found["changed"] is False
    assert found["explained_by"][0]["what"] == "moved"
    assert "3.00 degrees" in found["explained_by"][0]["text"]


def test_signed_campaigns(campaign: Callable[..., Path]) -> None:
    first = campaign("a", phase=PhaseReference.TABLE)
    found = compare(first, campaign("b", seed=2, phase=PhaseReference.TABLE))
    assert found["changed"] is False
    assert len(found["modes"]) == 3


def test_few_frequencies_compare_the_envelopes(campaign: Callable[..., Path]) -> None:
    first = campaign("a", frequency=DWELLS)
    same = compare(first, campaign("b", frequency=DWELLS, seed=2))
    assert same["compared"] == "deflections"
    assert same["changed"] is False
    assert "too few steps for modes" in same["notes"][0]
    other = compare(first, campaign("c", STRUCTURE.with_stiffness(2, 0.6), frequency=DWELLS, seed=2))
    assert other["changed"] is True
    assert other["findings"][0]["what"] == "envelope"


def test_missing_frequencies_are_left_out(campaign: Callable[..., Path]) -> None:
    first = campaign("a", frequency=DWELLS)
    found = compare(first, campaign("b", frequency=np.array([5.0, 9.0, 12.0]), seed=2))
    assert "at 2 common frequencies" in found["notes"][0]
    assert found["notes"][1:] == ["only a has 8 Hz: not compared", "only b has 9 Hz: not compared"]
    assert "no frequency in common" in str(refused(first, campaign("c", frequency=np.array([6.0, 7.0]), seed=3)))


def test_different_targets(campaign: Callable[..., Path]) -> None:
    names = ("X01", *NAMES[1:])
    found = compare(campaign("a", frequency=DWELLS), campaign("b", frequency=DWELLS, seed=2, names=names))
    assert found["changed"] is False
    assert "only a has the targets L01" in found["notes"][0]
    error = refused(campaign("c"), campaign("d", names=tuple(f"Q{i}" for i in range(8))))
    assert "has no target of" in str(error)


def test_one_camera_against_two(campaign: Callable[..., Path]) -> None:
    found = compare(campaign("a", frequency=DWELLS), campaign("b", frequency=DWELLS, seed=2, directions="xz"))
    assert found["changed"] is False
    assert any("only the directions x, z are compared" in note for note in found["notes"])


def test_one_camera_against_two_over_a_sweep(campaign: Callable[..., Path]) -> None:
    other = campaign("b", STRUCTURE.with_stiffness(2, 0.98), seed=2, directions="xz")
    found = compare(campaign("a"), other, "--levels-mm", "190,380,570,760")
    assert found["findings"][0]["where"].startswith("storey 3")
    assert any("only the directions x, z are compared" in note for note in found["notes"])
    assert len(found["modes"]) == 3
    assert set(found["modes"][0]) >= {"z_shift", "z_damping_change", "z_mac"}
    assert found["comac"]["L04"].keys() == {"value", "sd", "expected", "z"}
    assert found["modes"][1]["node_shifts"][0].keys() == {"member", "height_mm", "shift_mm", "sd_mm", "z"}


def test_too_few_targets_in_common_are_said(campaign: Callable[..., Path]) -> None:
    names = ("L01", *(f"Q{i}" for i in range(7)))
    error = refused(campaign("a", frequency=DWELLS), campaign("b", frequency=DWELLS, seed=2, names=names))
    assert "shares frequencies" in str(error)
    assert "fewer than 4 components" in str(error)


def test_moved_targets_are_said(campaign: Callable[..., Path], tmp_path: Path) -> None:
    series = Instrument().measure(STRUCTURE, DWELLS, np.random.default_rng(2))
    positions = STRUCTURE.positions_mm()
    positions[3, 2] += 60.0
    other = write_campaign(tmp_path / "b", replace(series, targets=NAMES), positions)
    assert any("targets were moved" in note for note in compare(campaign("a", frequency=DWELLS), other)["notes"])


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda folder: (folder / "results" / "envelope.csv").unlink(), "no envelope.csv"),
        (lambda folder: (folder / "results" / "envelope.csv").write_text(f"{HEADER}\n"), "is empty"),
        (lambda folder: (folder / "results" / "envelope.csv").write_bytes(b"\xff\xfe\x00"), "is not UTF-8 text"),
        (lambda folder: (folder / "results" / "envelope.csv").write_text("a,b\n1,2\n"), "no result file of labdaemon"),
        (lambda folder: [path.unlink() for path in folder.glob("captures/*/capture.toml")], "no frequency is known"),
        (
            lambda folder: edit(folder, lambda row: row | {"capture": row["target"], "target": row["capture"]}),
            "columns were swapped",
        ),
        (lambda folder: edit(folder, lambda row: row | {"flags": "poor_fit"}), "24 poor_fit"),
        (
            lambda folder: edit(folder, lambda row: row | {name: "" for name in row if name.startswith("sd_a")}),
            "no usable motion",
        ),
    ],
)
def test_unusable_folders(campaign: Callable[..., Path], spoil: Callable[[Path], Any], text: str) -> None:
    first, second = campaign("a", frequency=DWELLS), campaign("b", frequency=DWELLS, seed=2)
    spoil(second)
    error = refused(first, second)
    assert isinstance(error, DataError)
    assert text in str(error)


def test_a_wrong_capture_file_is_named(campaign: Callable[..., Path]) -> None:
    second = campaign("b", seed=2)
    (second / "captures" / "0003" / "capture.toml").write_text('frequency_hz = "five"')
    error = refused(campaign("a"), second)
    assert isinstance(error, ConfigError)
    assert "0003/capture.toml: frequency_hz" in str(error)


def test_captures_without_a_frequency_are_counted(campaign: Callable[..., Path]) -> None:
    second = campaign("b", frequency=DWELLS, seed=2)
    (second / "captures" / "0000" / "capture.toml").write_text("exposure_s = 1.0\n")
    notes = compare(campaign("a", frequency=DWELLS), second)["notes"]
    assert any("1 of 3 captures state no frequency" in note for note in notes)


def test_an_unknown_table_amplitude_is_said(campaign: Callable[..., Path]) -> None:
    second = campaign("b", frequency=DWELLS, seed=2)
    for path in second.glob("captures/*/capture.toml"):
        path.write_text(path.read_text().split("excitation")[0])
    found = compare(campaign("a", frequency=DWELLS), second)
    assert any("do not state the table's amplitude" in note for note in found["notes"])


def test_a_missing_folder(campaign: Callable[..., Path], tmp_path: Path) -> None:
    assert "nowhere" in str(refused(campaign("a"), tmp_path / "nowhere"))


@pytest.mark.parametrize("levels", ["", "190", "a,b", "380,190", "-1,5", "1,nan"])
def test_wrong_levels(campaign: Callable[..., Path], levels: str) -> None:
    error = refused(campaign("a"), campaign("b"), "--levels-mm", levels)
    assert isinstance(error, UsageError)
    assert "ascending heights" in str(error)


def test_a_gauge_on_the_table_is_believed(campaign: Callable[..., Path]) -> None:
    """The stated amplitude is 20 % off, the gauge says so."""
    first, second = campaign("a", frequency=DWELLS), campaign("b", frequency=DWELLS, seed=2)
    for path in second.glob("captures/*/capture.toml"):
        line = next(one for one in path.read_text().splitlines() if one.startswith("excitation"))
        amplitude = float(line.split("=")[1])
        path.write_text(
            path.read_text().replace(line, f"excitation_amplitude_mm = {1.2 * amplitude}")
            + f'\n[gauges.bed]\nrole = "table"\namplitude_mm = {amplitude}\nsd_amplitude_mm = {0.001 * amplitude}\n'
            + '\n[gauges.top]\nrole = "response"\namplitude_mm = 9.0\nsd_amplitude_mm = 0.01\n'
            + '\n[gauges.silent]\nrole = "table"\nreason = "silent"\n'
        )
    found = compare(first, second)
    assert found["changed"] is False
    assert found["explained_by"] == []


def test_modes_that_all_moved_far_leave_the_envelopes(campaign: Callable[..., Path]) -> None:
    """No mode is within reach of one of the baseline, but all frequencies of the sweep are common."""
    band = np.geomspace(4.0, 8.0, 18)
    soft = replace(STRUCTURE.scaled(stiffness=1.9), mass_kg=(0.9, 0.4, 0.5, 0.3))
    found = compare(campaign("a", frequency=band), campaign("b", soft, frequency=band, seed=2))
    assert found["changed"] is True


def test_what_cannot_differ_or_does_not_move_is_said(campaign: Callable[..., Path], tmp_path: Path) -> None:
    first = campaign("a", frequency=DWELLS)
    assert compare(first, tmp_path / "." / "a")["notes"][0] == "both are the folder a: nothing can differ"
    copied = shutil.copytree(first, tmp_path / "copied")
    assert "one folder is a copy of the other" in compare(first, copied)["notes"][0]
    edit(copied, lambda row: row | {"flags": "at_rest"})
    assert "copied: all targets are at rest: nothing moves" in compare(first, copied)["notes"]
    swapped = campaign("b", frequency=DWELLS, seed=2)
    sizes = {f"{name}{axis}_mm": "0.5" for name in ("sd_a", "sd_b") for axis in "xyz"}
    edit(swapped, lambda row: row | sizes | {f"a{axis}_mm": "0.01" for axis in "xyz"})
    assert any("are columns swapped?" in note for note in compare(first, swapped)["notes"])


def test_a_campaign_without_phase_and_one_with_it(campaign: Callable[..., Path]) -> None:
    signed = campaign("b", frequency=DWELLS, seed=2, phase=PhaseReference.TABLE)
    notes = compare(campaign("a", frequency=DWELLS), signed)["notes"]
    assert notes[0] == "only b shows phases throughout: signs and phases are not compared"


def test_a_sweep_that_was_aborted_is_compared_as_far_as_it_went(campaign: Callable[..., Path]) -> None:
    second = campaign("b", seed=2)
    edit(second, lambda row: row if int(row["capture"]) < 9 else {})
    found = compare(campaign("a"), second)
    assert len(found["modes"]) == 1
    assert any("only the band from 3.5 to 15.23 Hz was measured in both" in note for note in found["notes"])
