"""Which writer makes which file: the suffix decides."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from labdaemon.analysis.verification import CRATE
from labdaemon.durable import make_folder, move_durably
from labdaemon.errors import StorageError, UsageError
from labdaemon.export.results import FolderResults, read_results

Writer = Callable[[FolderResults, Path], None]


@dataclass(frozen=True, slots=True)
class FileFormat:
    """A file format.

    Attributes
    ----------
    name
        For people.
    module
        Of this package; its function ``write(results, path)`` makes the file.
    packages
        Needed, from the extra `export`.
    """

    name: str
    module: str
    packages: tuple[str, ...] = ()

    def writer(self) -> Writer:
        """Import the writer.

        Raises
        ------
        UsageError
            A package is not installed; the message says how to get it.
        """
        for package in self.packages:
            try:
                import_module(package)
            except ImportError:
                raise UsageError(
                    f"{self.name} needs the package {package}; run: pip install 'labdaemon[export]'"
                ) from None
        writer: Writer = import_module(f"labdaemon.export.{self.module}").write
        return writer


FORMATS = {
    ".h5": FileFormat("HDF5", "hdf5", ("h5py",)),
    ".mat": FileFormat("MATLAB", "matlab"),
    ".nc": FileFormat("netCDF", "netcdf", ("h5py", "h5netcdf", "xarray")),
    ".parquet": FileFormat("Parquet", "parquet", ("pyarrow",)),
    ".uff": FileFormat("UFF", "universal_file", ("pyuff",)),
    ".vtp": FileFormat("VTK", "paraview"),
}
"""Formats by the suffix of the file."""


def export_folder(folder: Path, to: Path, *, results: Path | None = None) -> Path:
    """Write the envelopes of a data-set folder in the format that the suffix of `to` names.

    The file is written whole or not at all.

    Parameters
    ----------
    folder
        The data-set folder.
    to
        The file.
    results
        Folder of the result files; FOLDER/results if None.

    Raises
    ------
    UsageError
        The suffix is of no known format, or a package is missing.
    DataError
        There are no results.
    StorageError
        The file cannot be written.
    """
    form = FileFormat("RO-Crate", "crate") if to.name == CRATE else FORMATS.get(to.suffix.lower())
    if to.name == CRATE and to.parent.resolve() != folder.resolve():
        raise UsageError(f"{to}: describes the folder in which it lies; write it to {folder / CRATE}")
    if form is None:
        known = ", ".join(f"{suffix} ({one.name})" for suffix, one in FORMATS.items())
        raise UsageError(f"{to.name}: the suffix is of no format that can be written; use one of {known}, or {CRATE}")
    write = form.writer()
    read = read_results(folder, results)
    # The suffix stays: some writers add their own to a name that lacks it.
    part = to.with_name(f".{to.stem}.part{to.suffix}")
    make_folder(to.parent)
    try:
        write(read, part)
        move_durably(part, to)
    except OSError as exc:
        raise StorageError(f"cannot be written ({exc.strerror or exc})", file=to) from None
    finally:
        with contextlib.suppress(OSError):  # the first reason is the one to report
            part.unlink(missing_ok=True)
    return to
