"""A series of envelopes written as a campaign leaves it, so that what reads campaigns can be tried without frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from labdaemon.findings import PhaseReference, ResponseSeries
from labdaemon.findings.response import FloatArray
from labdaemon.processing import ENVELOPE_COLUMNS, Row, write_csv

SD_POSITION_MM = 0.02


def write_campaign(
    folder: Path,
    series: ResponseSeries,
    positions_mm: FloatArray,
    *,
    rotation: FloatArray | None = None,
    directions: str = "xyz",
) -> Path:
    """Write `results/envelope.csv` and each capture's `capture.toml`; steps with phase state coded light.

    Parameters
    ----------
    rotation
        (3, 3) of the axes in which positions and motion are given: cameras that were oriented anew.
    directions
        Those that were measured; one camera sees a plane.

    Returns
    -------
    Path
        The folder.
    """
    turn = np.eye(3) if rotation is None else rotation
    rows: list[Row] = []
    for step in range(series.steps):
        name = f"{step:04d}"
        is_signed = series.phase is not PhaseReference.TARGET or bool(series.signed_steps()[step])
        about: dict[str, Any] = {
            "frequency_hz": float(series.frequency_hz[step]),
            "excitation_amplitude_mm": float(series.table_mm[step]),
        }
        if is_signed:
            about |= {"light": [1, 1, 1, 0, 1, 0, 0], "light_phase_rad": 0.0, "light_cycles": 8}
        path = folder / "captures" / name
        path.mkdir(parents=True, exist_ok=True)
        (path / "capture.toml").write_text(tomli_w.dumps(about), encoding="utf-8")
        for place, target in enumerate(series.targets):
            vector = turn @ series.amplitude[step, place]
            a, b = vector.real, vector.imag
            if not is_signed:  # semi-axes have no sign of their own
                a, b = (one if one[np.argmax(np.abs(one))] >= 0 else -one for one in (a, b))
            row: Row = {"capture": name, "target": target, "residual_ratio": None, "flags": [], "sign": None}
            for number, axis in enumerate("xyz"):
                is_there = axis in directions
                row[f"{axis}_mm"] = float((turn @ positions_mm[place])[number])
                row[f"a{axis}_mm"], row[f"b{axis}_mm"] = (float(v[number]) if is_there else 0.0 for v in (a, b))
                row[f"sd_{axis}_mm"] = SD_POSITION_MM if is_there else None
                row[f"sd_a{axis}_mm"] = float(series.sd_real[step, place, number]) if is_there else None
                row[f"sd_b{axis}_mm"] = float(series.sd_imag[step, place, number]) if is_there else None
            rows.append(row)
    (folder / "results").mkdir(exist_ok=True)
    write_csv(folder / "results" / "envelope.csv", ENVELOPE_COLUMNS, rows)
    return folder
