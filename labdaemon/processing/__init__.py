"""A capture's frames -> its envelope: files read, targets located, motion measured, cameras joined.

The daemon and the command line both come through here: `prepare_sharp` once a sharp set, `measure_capture` for each
capture, `process_folder` for a whole data-set folder, all of them the same functions on the same files, so that a
campaign processed again gives the same numbers.
"""

from labdaemon.processing.boards import CharucoBoard
from labdaemon.processing.calibration import CameraCalibration, board_files, calibrate, read_board
from labdaemon.processing.control import check_family
from labdaemon.processing.envelope import CaptureResult, join_motions, measure_capture, measure_in_folder
from labdaemon.processing.excitation_facts import (
    CaptureFacts,
    TableAmplitude,
    capture_facts,
    check_captures,
    is_positive,
    shows_phase,
    table_motion,
)
from labdaemon.processing.folder import NOT_FRAMES, CaptureFile, DataFolder, open_folder, sharp_sets
from labdaemon.processing.frame import measure_frames, measure_raw
from labdaemon.processing.frame_size import check_frame_sizes
from labdaemon.processing.matched_filter import BlurredTarget
from labdaemon.processing.photomodeler import calibrate_export
from labdaemon.processing.pool import WorkerPool
from labdaemon.processing.prepare import (
    PreparedCamera,
    name_dots,
    prepare_camera,
    prepare_frames,
    prepare_patch_frames,
    prepare_patches,
)
from labdaemon.processing.result_reader import read_csv
from labdaemon.processing.results_place import FILES, RESULTS, Stamp, stamps
from labdaemon.processing.run import FolderResult, jobs, process_folder
from labdaemon.processing.sharpset import SharpSet, prepare_sharp
from labdaemon.processing.shift import frame_shift
from labdaemon.processing.survey import read_control, read_patches, read_targets
from labdaemon.processing.tables import (
    ENVELOPE_COLUMNS,
    MEASUREMENT_COLUMNS,
    Row,
    csv_text,
    measurement_row,
    write_csv,
)
from labdaemon.processing.target_search import locate_targets

__all__ = [
    "ENVELOPE_COLUMNS",
    "FILES",
    "MEASUREMENT_COLUMNS",
    "NOT_FRAMES",
    "RESULTS",
    "BlurredTarget",
    "CameraCalibration",
    "CaptureFacts",
    "CaptureFile",
    "CaptureResult",
    "CharucoBoard",
    "DataFolder",
    "FolderResult",
    "PreparedCamera",
    "Row",
    "SharpSet",
    "Stamp",
    "TableAmplitude",
    "WorkerPool",
    "board_files",
    "calibrate",
    "calibrate_export",
    "capture_facts",
    "check_captures",
    "check_family",
    "check_frame_sizes",
    "csv_text",
    "frame_shift",
    "is_positive",
    "jobs",
    "join_motions",
    "locate_targets",
    "measure_capture",
    "measure_frames",
    "measure_in_folder",
    "measure_raw",
    "measurement_row",
    "name_dots",
    "open_folder",
    "prepare_camera",
    "prepare_frames",
    "prepare_patch_frames",
    "prepare_patches",
    "prepare_sharp",
    "process_folder",
    "read_board",
    "read_control",
    "read_csv",
    "read_patches",
    "read_targets",
    "sharp_sets",
    "shows_phase",
    "stamps",
    "table_motion",
    "write_csv",
]
