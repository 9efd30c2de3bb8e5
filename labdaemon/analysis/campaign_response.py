"""A campaign's result files as a series that `findings` can fit: which targets moved how at which frequency."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labdaemon.envelope import TargetEnvelope
from labdaemon.errors import ConfigError, DataError
from labdaemon.findings import ResponseSeries
from labdaemon.findings.envelope_series import UNKNOWN_TABLE_SD, MeasuredStep, envelope_series
from labdaemon.findings.response import BoolArray, FloatArray
from labdaemon.processing import RESULTS, CaptureFacts, capture_facts, is_positive, read_csv, table_motion
from labdaemon.tomlfile import read_toml


@dataclass(frozen=True, slots=True, eq=False)
class CampaignResponse:
    """What a folder says about the structure's response.

    Attributes
    ----------
    folder
        The data-set folder.
    series
        Targets at steps with a frequency.
    positions_mm
        (T, 3) mean positions over all captures.
    directions
        (3,) which of x, y and z were measured.
    notes
        What was left out, one sentence each.
    """

    folder: Path
    series: ResponseSeries
    positions_mm: FloatArray
    directions: BoolArray
    notes: tuple[str, ...]


def read_campaign(folder: Path, results: Path | None = None) -> CampaignResponse:
    """Read the envelopes of a data-set folder.

    Parameters
    ----------
    folder
        The data-set folder.
    results
        Where its result files are; FOLDER/results by default.

    Raises
    ------
    DataError
        There are no results, or nothing in them can be used.
    ConfigError
        A capture.toml is wrong.
    """
    path = (results or folder / RESULTS) / "envelope.csv"
    if not os.path.isfile(path) and os.path.isfile(folder / "envelope.csv"):
        path = folder / "envelope.csv"
    if not os.path.isfile(path):
        raise DataError("no envelope.csv in its results; run: labdaemon process FOLDER", file=folder)
    rows: dict[str, dict[str, TargetEnvelope]] = {}
    try:
        for row in read_csv(path):
            rows.setdefault(str(row["capture"]), {})[str(row["target"])] = TargetEnvelope.from_row(row)
    except (KeyError, ValueError, TypeError, UnicodeDecodeError, csv.Error) as exc:
        raise DataError(f"is no table of envelopes ({exc})", file=path) from None
    if not rows:
        raise DataError("has no envelopes: the campaign is empty", file=path)
    return _assemble(folder, rows, _captures(folder), capture_facts(folder))


def _captures(folder: Path) -> dict[str, dict[str, Any]]:
    """What each capture.toml says, by capture and by group."""
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(folder.glob("captures/*/capture.toml")):
        _, about = read_toml(path)
        for key in ("frequency_hz", "excitation_amplitude_mm"):
            value = about.get(key)
            if value is not None and not is_positive(value):
                raise ConfigError(f"must be a positive number, not {value!r}", source=path, key=key)
        found[path.parent.name] = about
        if about.get("group"):
            found[str(about["group"])] = about
    return found


def _assemble(
    folder: Path,
    rows: dict[str, dict[str, TargetEnvelope]],
    about: dict[str, dict[str, Any]],
    facts: dict[str, CaptureFacts],
) -> CampaignResponse:
    known = [name for name in rows if about.get(name, {}).get("frequency_hz")]
    notes = []
    if len(known) < len(rows):
        notes.append(f"{folder.name}: {len(rows) - len(known)} of {len(rows)} captures state no frequency; left out")
    if not known:
        raise DataError("no capture states its frequency_hz in capture.toml: nothing can be compared", file=folder)
    steps = [_step(about[name], rows[name], facts[name].is_phase_known) for name in known]
    found = envelope_series(steps)
    if found.left_out:
        listed = ", ".join(f"{count} {name}" for name, count in found.left_out.most_common())
        notes.append(f"{folder.name}: rows with flags are left out ({listed})")
    missing = sum(step.sd_table == UNKNOWN_TABLE_SD for step in steps)
    if missing:
        notes.append(f"{folder.name}: {missing} captures do not state the table's amplitude, so it is taken as unknown")
    return CampaignResponse(folder, found.series, found.positions_mm, found.directions, tuple(notes))


def _step(about: dict[str, Any], targets: dict[str, TargetEnvelope], is_signed: bool) -> MeasuredStep:
    frequency_hz, table = float(about["frequency_hz"]), table_motion(about)
    if table is None:
        return MeasuredStep(frequency_hz, targets, is_signed=is_signed)
    relative_sd = table.sd_mm / table.amplitude_mm
    return MeasuredStep(
        frequency_hz, targets, table.amplitude_mm, relative_sd, table.phase_rad, table.sd_phase_rad, is_signed
    )
