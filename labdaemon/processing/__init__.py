"""A capture's frames -> its envelope: files read, targets found again, motion measured, cameras joined.

The daemon and the command line both come through here: `prepare_sharp` once a sharp set, `measure_capture` for each
capture, `process_folder` for a whole data-set folder, all of them the same functions on the same files, so that a
campaign processed again gives the same numbers.
"""

from labdaemon.processing.envelope import CaptureResult, measure_capture
from labdaemon.processing.pool import WorkerPool
from labdaemon.processing.run import FolderResult, process_folder
from labdaemon.processing.sharpset import SharpSet, prepare_sharp
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, Row, read_csv, write_csv

__all__ = [
    "ENVELOPE_COLUMNS",
    "MEASUREMENT_COLUMNS",
    "CaptureResult",
    "FolderResult",
    "Row",
    "SharpSet",
    "WorkerPool",
    "measure_capture",
    "prepare_sharp",
    "process_folder",
    "read_csv",
    "write_csv",
]
