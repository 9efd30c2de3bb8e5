"""netCDF-4 through xarray: labelled dimensions capture, target and axis, units as attributes (CF names)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from labdaemon.export.cube import COVARIANCES, PER_CAPTURE, SCALARS, VECTORS, EnvelopeCube, covariance_axis
from labdaemon.export.results import FolderResults
from labdaemon.version import __version__

if TYPE_CHECKING:
    import xarray as xr


def to_dataset(results: FolderResults) -> xr.Dataset:
    """All envelopes as an xarray data set."""
    import xarray as xr

    cube = EnvelopeCube.of(results)
    pair, triple = ("capture", "target"), ("capture", "target", "axis")
    data = {
        **{
            name: (triple, cube.vectors[name], {"units": "mm", "long_name": meaning})
            for name, meaning in VECTORS.items()
        },
        **{
            name: (pair, cube.scalars[name], {"units": unit, "long_name": meaning})
            for name, (unit, meaning) in SCALARS.items()
        },
        **{
            name: (
                (*pair, _axis(name), f"other_{_axis(name)}"),
                cube.covariances[name],
                {"units": "mm2", "long_name": meaning},
            )
            for name, (_, meaning) in COVARIANCES.items()
        },
        "flags": (pair, cube.flags.astype(object)),
        "is_phase_known": ("capture", cube.is_phase_known.astype("i1")),
        "opened_at": ("capture", cube.opened_at.astype(object)),
    }
    coordinates = {
        "capture": list(cube.captures),
        "target": list(cube.targets),
        "axis": ["x", "y", "z"],
        **{f"{other}{_axis(name)}": covariance_axis(name) for name in COVARIANCES for other in ("", "other_")},
        **{
            name: ("capture", cube.per_capture[name], {"units": unit, "long_name": meaning})
            for name, (unit, meaning) in PER_CAPTURE.items()
        },
    }
    attributes = {
        "Conventions": "CF-1.11",
        "title": results.folder.resolve().name,
        "source": f"labdaemon {__version__}",
    }
    return xr.Dataset(data, coordinates, attributes)


def _axis(name: str) -> str:
    """Name of a covariance's dimension: ``mean`` or ``motion``."""
    return name.split("_")[1]


def write(results: FolderResults, path: Path) -> None:
    """Write the file."""
    to_dataset(results).to_netcdf(path, engine="h5netcdf", format="NETCDF4")
