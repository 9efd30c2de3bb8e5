"""Parquet: the rows of `envelope.csv` with excitation and time as columns, units in the metadata of each column."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from labdaemon.export.cube import COVARIANCES, PER_CAPTURE, SCALARS, EnvelopeCube, covariance_axis
from labdaemon.export.results import FolderResults
from labdaemon.version import __version__

_PREFIXES = {"mean_mm": "", "a_mm": "a", "b_mm": "b", "sd_mean_mm": "sd_", "sd_a_mm": "sd_a", "sd_b_mm": "sd_b"}
"""Column names of `envelope.csv`, less their axis, by vector."""


def to_table(results: FolderResults) -> pa.Table:
    """All envelopes as one table, a row per capture and target. Empty numbers are null.

    Covariances are the columns ``cov_ax_bx_mm2`` and so on; the variances are the squares of the ``sd_`` columns.
    """
    cube = EnvelopeCube.of(results)
    shape = (len(cube.captures), len(cube.targets))
    columns: dict[str, tuple[pa.Array, str | None]] = {
        "capture": (pa.array(np.repeat(cube.captures, shape[1])), None),
        "target": (pa.array(np.tile(cube.targets, shape[0])), None),
    }
    for name, (unit, _) in PER_CAPTURE.items():
        columns[name] = (_numbers(np.repeat(cube.per_capture[name], shape[1])), unit)
    columns["opened_at"] = (pa.array([text or None for text in np.repeat(cube.opened_at, shape[1])], pa.string()), None)
    columns["is_phase_known"] = (pa.array(np.repeat(cube.is_phase_known, shape[1])), None)
    for name, prefix in _PREFIXES.items():
        for axis, letter in enumerate("xyz"):
            columns[f"{prefix}{letter}_mm"] = (_numbers(cube.vectors[name][..., axis].ravel()), "mm")
    for name, (unit, _) in SCALARS.items():
        columns[name] = (_numbers(cube.scalars[name].ravel()), unit)
    for name in COVARIANCES:
        numbers = [one.removesuffix("_mm") for one in covariance_axis(name)]
        for i, j in zip(*np.triu_indices(len(numbers), 1), strict=True):
            columns[f"cov_{numbers[i]}_{numbers[j]}_mm2"] = (_numbers(cube.covariances[name][..., i, j].ravel()), "mm2")
    flags = [text.split(";") if text else [] for text in cube.flags.ravel()]
    columns["flags"] = (pa.array(flags, pa.list_(pa.string())), None)
    fields = [
        pa.field(name, array.type, metadata={"unit": unit} if unit else None) for name, (array, unit) in columns.items()
    ]
    about = {"source": f"labdaemon {__version__}", "title": results.folder.resolve().name}
    schema = pa.schema(fields, metadata={"labdaemon": json.dumps(about)})
    return pa.table([array for array, _ in columns.values()], schema=schema)


def write(results: FolderResults, path: Path) -> None:
    """Write the file."""
    pq.write_table(to_table(results), path)


def _numbers(values: NDArray[np.float64]) -> pa.Array:
    return pa.array(values, pa.float64(), from_pandas=True)
