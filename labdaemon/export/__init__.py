"""Results of a data-set folder in the files of other tools: HDF5, Parquet, UFF, VTK, MATLAB, netCDF, RO-Crate."""

from labdaemon.analysis.verification import CRATE
from labdaemon.export.cube import EnvelopeCube
from labdaemon.export.formats import FORMATS, export_folder
from labdaemon.export.results import FolderResults, read_results

__all__ = ["CRATE", "FORMATS", "EnvelopeCube", "FolderResults", "export_folder", "read_results"]
