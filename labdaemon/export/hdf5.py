"""HDF5: one dataset per quantity, (captures, targets, 3), units as attributes.

Layout: ``/capture/*`` (captures,), ``/target/name`` (targets,), ``/envelope/*`` with x, y, z last,
``/envelope/covariance_*`` (captures, targets, n, n). Names of axes are HDF5 dimension scales.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py

from labdaemon.export.cube import COVARIANCES, PER_CAPTURE, SCALARS, VECTORS, EnvelopeCube, covariance_axis
from labdaemon.export.results import FolderResults
from labdaemon.version import __version__


def write(results: FolderResults, path: Path) -> None:
    """Write the file."""
    cube = EnvelopeCube.of(results)
    text = h5py.string_dtype()
    with h5py.File(path, "w") as file:
        file.attrs["title"] = results.folder.resolve().name
        file.attrs["source"] = f"labdaemon {__version__}"
        file.attrs["motion"] = "d(t) = a sin(2 pi f t) + b cos(2 pi f t), amplitudes zero to peak"
        names = {
            "capture": file.create_dataset("capture/name", data=list(cube.captures), dtype=text),
            "target": file.create_dataset("target/name", data=list(cube.targets), dtype=text),
        }
        for name, (unit, meaning) in PER_CAPTURE.items():
            _describe(file.create_dataset(f"capture/{name}", data=cube.per_capture[name]), unit, meaning)
        file.create_dataset("capture/opened_at", data=cube.opened_at.astype(object), dtype=text)
        file.create_dataset("capture/is_phase_known", data=cube.is_phase_known)
        for name, meaning in VECTORS.items():
            data = file.create_dataset(f"envelope/{name}", data=cube.vectors[name])
            _describe(data, "mm", meaning)
            data.dims[2].label = "x, y, z"
        for name, (unit, meaning) in SCALARS.items():
            _describe(file.create_dataset(f"envelope/{name}", data=cube.scalars[name]), unit, meaning)
        for name, (_, meaning) in COVARIANCES.items():
            data = file.create_dataset(f"envelope/{name}", data=cube.covariances[name], compression="gzip")
            _describe(data, "mm2", meaning)
            data.dims[2].label = data.dims[3].label = ", ".join(covariance_axis(name))
        file.create_dataset("envelope/flags", data=cube.flags.astype(object), dtype=text)
        _name_axes(file, names)


def _describe(data: Any, unit: str, meaning: str) -> None:
    data.attrs["units"], data.attrs["long_name"] = unit, meaning


def _name_axes(file: Any, names: dict[str, Any]) -> None:
    """Attach the names of captures and targets to the axes of every dataset."""
    for name, data in names.items():
        data.make_scale(name)
    for data in file["envelope"].values():
        for axis, name in enumerate(("capture", "target")):
            data.dims[axis].label = name
            data.dims[axis].attach_scale(names[name])
