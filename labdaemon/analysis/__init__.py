"""Functions for notebooks and scripts: read frames, measure motion, process folders.

``import labdaemon as ld`` offers them as ``ld.read_frame``, ``ld.frame_from_array``, ``ld.measure`` and ``ld.process``.
They are the functions of the commands, on the same files, so that a notebook and a CSV file agree.
"""

from labdaemon.analysis.arrays import frame_from_array
from labdaemon.analysis.measuring import measure
from labdaemon.analysis.motion_table import MotionTable
from labdaemon.analysis.processing import ProcessedFolder, process
from labdaemon.imaging import read_frame

__all__ = ["MotionTable", "ProcessedFolder", "frame_from_array", "measure", "process", "read_frame"]
