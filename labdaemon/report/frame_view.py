"""A frame with its vectors as a small JPEG on standard output: what the live page shows of the last capture.

``python -m labdaemon.report.frame_view FRAME CAMERA CAPTURE RESULTS``; RESULTS is empty where the capture is not
measured yet.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from labdaemon.errors import LabdaemonError
from labdaemon.imaging import read_frame
from labdaemon.orbit_size import size_mm
from labdaemon.processing import Row, read_csv
from labdaemon.report.overlay import draw_overlay, readable_magnification

WIDTH_PX = 900
QUALITY = 78
"""Whatever the daemon measures comes first."""


def frame_view(frame: Path, camera: str, capture: str, results: Path | None) -> bytes:
    """Draw a frame.

    Parameters
    ----------
    frame
        The file.
    camera, capture
        Names; for a group, the group's.
    results
        Folder of the result files; None where the capture is not measured.

    Returns
    -------
    bytes
        A JPEG.

    Raises
    ------
    DataError
        The frame cannot be read.
    """
    rows = _rows(results, "measurements.csv", capture) if results is not None else []
    sizes = _rows(results, "envelope.csv", capture) if results is not None else []
    lengths = {str(row["target"]): size for row in sizes if (size := size_mm(row)) is not None}
    mine = [row for row in rows if row["camera"] == camera]
    grey = read_frame(frame).grey()
    factor = readable_magnification(rows, max(grey.shape))  # one for all cameras
    image = draw_overlay(grey, mine, title=f"{capture}  {camera}", lengths_mm=lengths or None, magnify=factor)
    height, width = image.shape[:2]
    if width > WIDTH_PX:
        image = np.asarray(
            cv2.resize(image, (WIDTH_PX, round(height * WIDTH_PX / width)), interpolation=cv2.INTER_AREA), np.uint8
        )
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return bytes(data.tobytes())


def _rows(results: Path, name: str, capture: str) -> list[Row]:
    path = results / name
    return [row for row in read_csv(path) if row["capture"] == capture] if path.is_file() else []


def main() -> int:
    """Draw what the command line names; the exit status is 1 where that fails."""
    frame, camera, capture, results = sys.argv[1:]
    try:
        image = frame_view(Path(frame), camera, capture, Path(results) if results else None)
    except LabdaemonError as exc:
        sys.stderr.write(f"{exc}\n")
        return 1
    sys.stdout.buffer.write(image)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
