"""A campaign's result files as a series that `findings` can fit: which targets moved how at which frequency."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labdaemon.envelope import TargetEnvelope
from labdaemon.errors import ConfigError, DataError
from labdaemon.findings import PhaseReference, ResponseSeries
from labdaemon.findings.response import BoolArray, ComplexArray, FloatArray
from labdaemon.flags import Flag
from labdaemon.processing import RESULTS, TableAmplitude, is_positive, read_csv, table_motion
from labdaemon.tomlfile import read_toml

UNKNOWN_TABLE_SD = 1.0
"""Relative sd of the table's amplitude where nothing states it."""
LARGEST_PHASE_SD = 0.3
"""Radians from which on the table's phase counts as unknown."""
RIGHT_ANGLE = 1e-3
"""Cosine below which two semi-axes are at right angles, given six decimals in the file."""


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
    if not path.is_file() and (folder / "envelope.csv").is_file():
        path = folder / "envelope.csv"
    if not path.is_file():
        raise DataError("no envelope.csv in its results; run: labdaemon process FOLDER", file=folder)
    rows: dict[str, dict[str, TargetEnvelope]] = {}
    try:
        for row in read_csv(path):
            rows.setdefault(str(row["capture"]), {})[str(row["target"])] = TargetEnvelope.from_row(row)
    except (KeyError, ValueError, TypeError, UnicodeDecodeError, csv.Error) as exc:
        raise DataError(f"is no table of envelopes ({exc})", file=path) from None
    if not rows:
        raise DataError("has no envelopes: the campaign is empty", file=path)
    return _assemble(folder, rows, _captures(folder))


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
    folder: Path, rows: dict[str, dict[str, TargetEnvelope]], about: dict[str, dict[str, Any]]
) -> CampaignResponse:
    known = [name for name in rows if about.get(name, {}).get("frequency_hz")]
    notes = []
    if len(known) < len(rows):
        notes.append(f"{folder.name}: {len(rows) - len(known)} of {len(rows)} captures state no frequency; left out")
    names = tuple(sorted({target for name in rows for target in rows[name]}))
    if not known:
        raise DataError("no capture states its frequency_hz in capture.toml: nothing can be compared", file=folder)
    counts: Counter[str] = Counter()
    shape = (len(known), len(names), 3)
    amplitude = np.full(shape, np.nan, complex)
    sd_real, sd_imag = np.full(shape, np.nan), np.full(shape, np.nan)
    position, at_rest = np.full(shape, np.nan), np.zeros(shape[:2], bool)
    for step, capture in enumerate(known):
        for place, target in enumerate(names):
            one = rows[capture].get(target)
            if one is None:
                continue
            position[step, place] = one.mean_mm
            doubts = one.flags - {Flag.AT_REST}
            if doubts:
                counts.update(flag.value for flag in doubts)
                continue
            amplitude[step, place] = one.a_mm + 1j * np.nan_to_num(one.b_mm)
            sd_real[step, place] = one.sd_a_mm
            sd_imag[step, place] = np.where(np.isfinite(one.sd_b_mm), one.sd_b_mm, one.sd_a_mm)
            at_rest[step, place] = Flag.AT_REST in one.flags
    if counts:
        listed = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        notes.append(f"{folder.name}: rows with flags are left out ({listed})")
    directions = np.isfinite(sd_real).any(axis=(0, 1))
    tables = [table_motion(about[name]) for name in known]
    if _is_signed(amplitude):
        phase, amplitude, sd_phase = _phases(amplitude, tables)
    else:
        phase, amplitude, sd_phase = PhaseReference.TARGET, _along_axes(amplitude), np.full(len(known), np.inf)
    missing = sum(one is None for one in tables)
    if missing:
        notes.append(f"{folder.name}: {missing} captures do not state the table's amplitude, so it is taken as unknown")
    series = ResponseSeries(
        np.array([float(about[name]["frequency_hz"]) for name in known]),
        amplitude,
        sd_real,
        sd_imag,
        np.array([1.0 if one is None else one.amplitude_mm for one in tables]),
        np.array([_relative_sd(one) for one in tables]),
        phase,
        at_rest,
        names,
        sd_phase,
    )
    return CampaignResponse(folder, series, _mean_positions(position), directions, tuple(notes))


def _relative_sd(table: TableAmplitude | None) -> float:
    return UNKNOWN_TABLE_SD if table is None else table.sd_mm / table.amplitude_mm


def _phases(
    amplitude: ComplexArray, tables: list[TableAmplitude | None]
) -> tuple[PhaseReference, ComplexArray, FloatArray]:
    """What phases refer to, amplitudes in that reference, and (K,) sd of the table's phase.

    Where a gauge saw the table's phase in every capture, phases refer to the table; else each step has a phase of its
    own, as the drive's phase against the excitation's reference is not known.
    """
    phase = np.array([0.0 if one is None or one.phase_rad is None else one.phase_rad for one in tables])
    sd = np.array([np.inf if one is None or one.sd_phase_rad is None else one.sd_phase_rad for one in tables])
    sd = np.where(sd < LARGEST_PHASE_SD, sd, np.inf)
    if not np.isfinite(sd).all():
        return PhaseReference.STEP, amplitude, np.full(len(sd), np.inf)
    return PhaseReference.TABLE, amplitude * np.exp(-1j * phase)[:, None, None], sd


def _mean_positions(position: FloatArray) -> FloatArray:
    count = np.isfinite(position).sum(axis=0)
    total = np.nansum(position, axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _is_signed(amplitude: ComplexArray) -> bool:
    """Whether every capture carries a phase: its vectors are then not the semi-axes in their fixed order and sign."""
    is_signed = []
    for step in amplitude:
        value = step[np.isfinite(step).all(axis=1)]
        if not len(value):
            continue
        a, b = value.real, value.imag
        size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        slanted = np.abs(np.sum(a * b, axis=1)) > RIGHT_ANGLE * size + 1e-5 * np.linalg.norm(a, axis=1)
        largest = np.take_along_axis(a, np.argmax(np.abs(a), axis=1)[:, None], axis=1)[:, 0]
        longer = np.linalg.norm(b, axis=1) > np.linalg.norm(a, axis=1) + 1e-5
        is_signed.append(bool(np.any(slanted | (largest < 0) | longer)))
    return bool(is_signed) and all(is_signed)


def _along_axes(amplitude: ComplexArray) -> ComplexArray:
    """Amplitudes turned to the phase at which the major semi-axis is real."""
    square = np.nansum(amplitude**2, axis=2, keepdims=True)
    result: ComplexArray = amplitude * np.exp(-0.5j * np.angle(square))
    return result
