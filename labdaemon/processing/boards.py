"""Points of a calibration board in a photograph: corners of a ChArUco board, dots of a sheet with coded rings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import FloatArray
from labdaemon.errors import DataError, UsageError
from labdaemon.geometry import Node, apply_placement, grow_lattice, place_lattices
from labdaemon.imaging import dictionary, find_dots, find_rings, read_frame

Grey = NDArray[np.float32]

RING_KINDS: tuple[tuple[int, tuple[float, float], bool], ...] = (
    (12, (2.0, 3.0), False),
    (14, (2.0, 3.0), False),
    (8, (2.4, 4.2), True),
)
"""Segments, inner and outer radius in radii of the dot, and whether codes outside the book count: the conventional
rings and those of PhotoModeler's calibration sheet."""
DISPLAY_GAMMA = 2.2
"""Tone curve of a camera's JPEG, near enough to find the middle of an edge."""
JPEG = b"\xff\xd8\xff"
_FEWEST_POINTS = 8  # an image has six unknowns of its own, that is three points, and needs some to spare


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A ChArUco board: squares across and down, the marker's side in parts of a square's, and the markers' family."""

    columns: int
    rows: int
    marker: float = 0.75
    family: str = "aruco-4x4-100"

    @classmethod
    def parse(cls, text: str, marker: float, family: str) -> CharucoBoard:
        """Read ``9x6``.

        Raises
        ------
        UsageError
            It is not two whole numbers of at least 3, or the marker does not fit into a square.
        """
        match = re.fullmatch(r"(\d+)\s*[x×]\s*(\d+)", text.strip())
        if match is None or min(int(n) for n in match.groups()) < 3:
            raise UsageError(f"--charuco {text!r}: give the squares across and down, at least 3 each, as 9x6")
        if not 0.1 < marker < 1.0:
            raise UsageError(f"--marker {marker:g}: give the marker's side in parts of a square's, between 0.1 and 1")
        return cls(int(match.group(1)), int(match.group(2)), marker, family)


@dataclass(frozen=True, slots=True, eq=False)
class BoardImage:
    """What one photograph shows of the board.

    Attributes
    ----------
    file
        Where it came from.
    size
        (width, height) of the frame.
    serial
        The body's serial number, empty if the file has none.
    names
        Names of the points in view.
    image_px, board
        (n, 2) their pixels, and (n, 2) their places on the board, in steps of its grid.
    radius_px
        (n,) semi-major axes of dots, 0 for corners.
    """

    file: Path
    size: tuple[int, int]
    serial: str
    names: tuple[str, ...]
    image_px: FloatArray
    board: FloatArray
    radius_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SheetDots:
    """Dots and coded rings of one photograph, before it is known which dot is which."""

    file: Path
    size: tuple[int, int]
    serial: str
    centres_px: FloatArray
    radius_px: FloatArray
    rings: tuple[tuple[tuple[str, int], ...], ...]
    """For each of `RING_KINDS`: name and row of the dot in its middle."""


def load_grey(file: Path, *, jpeg: bool) -> tuple[Grey, tuple[int, int], str]:
    """Linear grey image of a photograph, its size, and the body's serial number.

    Parameters
    ----------
    file
        RAW, or 8/16-bit grey TIFF or PNG.
    jpeg
        Take JPEGs too. Their tone curve is only roughly known, and their frame is not the RAW file's.

    Raises
    ------
    DataError
        The file cannot be read, or is a JPEG that was not asked for.
    """
    with file.open("rb") as stream:
        is_jpeg = stream.read(3) == JPEG
    if not is_jpeg:
        frame = read_frame(file)
        return frame.grey(), frame.size, frame.serial
    if not jpeg:
        raise DataError(
            "is a JPEG, whose frame is another one than the RAW file's: photograph the board in RAW "
            "(or pass --jpeg for a camera that measures in JPEG)",
            file=file,
        )
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise DataError("cannot be decoded; the file is damaged", file=file)
    height, width = image.shape
    return ((image / 255.0) ** DISPLAY_GAMMA).astype(np.float32), (width, height), ""


def charuco_image(file: Path, board: CharucoBoard, *, jpeg: bool = False) -> BoardImage | None:
    """Corners of a ChArUco board in a photograph; None when it shows too few."""
    grey, size, serial = load_grey(file, jpeg=jpeg)
    pattern = cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, board.marker, dictionary(board.family))
    corners, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(_apply_tone_curve(grey))
    if ids is None or len(ids) < _FEWEST_POINTS:
        return None
    numbers = np.asarray(ids).ravel()
    places = np.asarray(pattern.getChessboardCorners(), dtype=float)[numbers, :2]
    return BoardImage(
        file,
        size,
        serial,
        tuple(str(number) for number in numbers),
        np.asarray(corners, dtype=float).reshape(-1, 2),
        places,
        np.zeros(len(numbers)),
    )


def sheet_dots(file: Path, *, jpeg: bool = False) -> SheetDots:
    """Dots and rings of a sheet in a photograph."""
    grey, size, serial = load_grey(file, jpeg=jpeg)
    dots = find_dots(grey)
    centres = np.array([[dot.x_px, dot.y_px] for dot in dots]).reshape(-1, 2)
    rings = []
    for bits, radii, unlisted in RING_KINDS:
        found = find_rings(grey, dots=dots, bits=bits, ring=radii, unlisted=unlisted)
        rows = [int(np.argmin(np.hypot(*(centres - [r.dot.x_px, r.dot.y_px]).T))) for r in found]
        rings.append(tuple((ring.name, row) for ring, row in zip(found, rows, strict=True)))
    return SheetDots(file, size, serial, centres, np.array([dot.semi_major_px for dot in dots]), tuple(rings))


def sheet_images(sheets: Sequence[SheetDots]) -> list[BoardImage]:
    """Give the dots of a sheet the same names in all its photographs.

    The sheet's dots lie on a square grid of which coded rings are nodes; two rings in common place one photograph's
    grid on another's. Photographs that cannot be placed are left out.

    Raises
    ------
    DataError
        No kind of ring is seen in enough photographs.
    """
    lattices = [grow_lattice(sheet.centres_px) for sheet in sheets]
    nodes = [{row: node for node, row in lattice.items()} for lattice in lattices]
    best: list[BoardImage] = []
    for kind in range(len(RING_KINDS)):
        marks = [_named_nodes(sheet.rings[kind], known) for sheet, known in zip(sheets, nodes, strict=True)]
        images = []
        for sheet, lattice, placement in zip(sheets, lattices, place_lattices(marks), strict=True):
            if placement is None or len(lattice) < _FEWEST_POINTS:
                continue
            places = [apply_placement(node, placement) for node in lattice]
            rows = list(lattice.values())
            images.append(
                BoardImage(
                    sheet.file,
                    sheet.size,
                    sheet.serial,
                    tuple(f"{i},{j}" for i, j in places),
                    sheet.centres_px[rows],
                    np.array(places, dtype=float),
                    sheet.radius_px[rows],
                )
            )
        if len(images) > len(best):
            best = images
    if len(best) < 2:
        raise DataError(
            "no sheet of dots with coded rings was recognised in two photographs: at least two rings must be in view "
            "(for a ChArUco board give --charuco)"
        )
    return best


def _named_nodes(rings: Sequence[tuple[str, int]], nodes: dict[int, Node]) -> dict[str, Node]:
    """Nodes of the rings by name; a name that is there twice marks nothing."""
    names = [name for name, row in rings if row in nodes]
    return {name: nodes[row] for name, row in rings if row in nodes and names.count(name) == 1}


def _apply_tone_curve(grey: Grey) -> NDArray[np.uint8]:
    """Eight bits with a tone curve, for detectors that were made for photographs."""
    white = float(np.percentile(grey, 99.5))
    toned = 255.0 * np.clip(grey / max(white, 1e-9), 0.0, 1.0) ** (1.0 / DISPLAY_GAMMA)
    return np.asarray(toned, dtype=np.uint8)
