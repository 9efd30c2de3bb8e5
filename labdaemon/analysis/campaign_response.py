"""A campaign's result files as a series that `findings` can fit: which targets moved how at which frequency."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labdaemon.envelope import TargetEnvelope
from labdaemon.errors import DataError
from labdaemon.findings import ResponseSeries
from labdaemon.findings.envelope_series import UNKNOWN_TABLE_SD, MeasuredStep, envelope_series
from labdaemon.findings.response import BoolArray, FloatArray
from labdaemon.processing import RESULTS, CaptureFacts, capture_facts, check_captures, read_csv


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
    if not os.path.isdir(folder):
        raise DataError("is not a folder", file=folder)
    path = (results or folder / RESULTS) / "envelope.csv"
    if not os.path.isfile(path) and os.path.isfile(folder / "envelope.csv"):
        path = folder / "envelope.csv"
    if not os.path.isfile(path):
        raise DataError("no envelope.csv in its results; run: labdaemon process FOLDER", file=folder)
    rows: dict[str, dict[str, TargetEnvelope]] = {}
    for row in read_csv(path):
        rows.setdefault(str(row["capture"]), {})[str(row["target"])] = TargetEnvelope.from_row(row)
    if not rows:
        raise DataError("has no envelopes: the campaign is empty", file=path)
    return _assemble(folder, rows, capture_facts(folder))


def _assemble(
    folder: Path, rows: dict[str, dict[str, TargetEnvelope]], facts: dict[str, CaptureFacts]
) -> CampaignResponse:
    notes = []
    strange = [name for name in rows if name not in facts]
    known = [name for name in rows if name in facts and facts[name].frequency_hz is not None]
    check_captures(folder, rows, facts)
    if not facts:
        raise DataError(
            "has no captures/*/capture.toml, so that no frequency is known: nothing can be compared", file=folder
        )
    if not known and strange:
        raise DataError(
            f"its results are of {_some(strange)}, which are in groups now or have no capture.toml: no frequency is "
            "known; run: labdaemon process FOLDER",
            file=folder,
        )
    if not known:
        raise DataError("no capture states its frequency_hz in capture.toml: nothing can be compared", file=folder)
    if strange:
        notes.append(f"{folder.name}: captures/ has nothing of {_some(strange)}; left out")
    silent = len(rows) - len(known) - len(strange)
    if silent:
        notes.append(f"{folder.name}: {silent} of {len(rows)} captures state no frequency; left out")
    steps = [_step(facts[name], rows[name]) for name in known]
    found = envelope_series(steps)
    if found.left_out:
        listed = ", ".join(f"{count} {name}" for name, count in found.left_out.most_common())
        notes.append(f"{folder.name}: rows with flags are left out ({listed})")
    missing = sum(step.sd_table == UNKNOWN_TABLE_SD for step in steps)
    if missing:
        notes.append(f"{folder.name}: {missing} captures do not state the table's amplitude, so it is taken as unknown")
    series, positions_mm = found.series, found.positions_mm
    is_seen = np.logical_and(series.valid().any(axis=(0, 2)), np.isfinite(positions_mm).all(axis=1))
    if is_seen.any() and not is_seen.all():
        lost = [name for name, seen in zip(series.targets, is_seen, strict=True) if not seen]
        notes.append(f"{folder.name}: never measured without a flag, and left out: {_some(lost)}")
        series, positions_mm = series.with_targets(np.flatnonzero(is_seen)), positions_mm[is_seen]
    notes += [f"{folder.name}: {text}" for text in _doubts(series)]
    return CampaignResponse(folder, series, positions_mm, found.directions, tuple(notes))


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (" …" if len(names) > 8 else "")


def _doubts(series: ResponseSeries) -> list[str]:
    """What makes these envelopes useless for a comparison although each is well-formed."""
    is_measured = series.valid()
    if not is_measured.any():
        return ["no target has a motion with a standard deviation: all are empty or flagged"]
    at_rest = series.resting()
    if at_rest[is_measured.any(axis=2)].all():
        return ["all targets are at rest: nothing moves"]
    size = np.sqrt(np.sum(np.where(is_measured, np.abs(series.amplitude) ** 2, 0.0), axis=2))
    spread = np.sqrt(np.sum(np.where(is_measured, series.sd_real**2, 0.0), axis=2))
    moving = is_measured.any(axis=2) & ~at_rest
    unsure = int(np.count_nonzero(spread[moving] > size[moving]))
    if unsure > len(size[moving]) / 2:
        return [
            f"{unsure} of {len(size[moving])} motions are smaller than their standard deviations without the flag "
            "at_rest: are columns swapped?"
        ]
    return []


def _step(facts: CaptureFacts, targets: dict[str, TargetEnvelope]) -> MeasuredStep:
    assert facts.frequency_hz is not None
    table, is_signed = facts.table, facts.is_phase_known
    if table is None:
        return MeasuredStep(facts.frequency_hz, targets, is_signed=is_signed)
    relative_sd = table.sd_mm / table.amplitude_mm
    return MeasuredStep(
        facts.frequency_hz, targets, table.amplitude_mm, relative_sd, table.phase_rad, table.sd_phase_rad, is_signed
    )
