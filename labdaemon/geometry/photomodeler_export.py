"""PhotoModeler's text export: one camera in Brown's backward model, images, points and their pixels.

Line by line: title; a header ending in the image size in pixels; default standard deviations; interior orientation
(c, px, py, format width, format height in mm, K1, K2, K3, P1, P2) and its standard deviations; for each image its
number and file, its exterior orientation (position, then kappa, phi, omega in degrees) with standard deviations, and
the camera again; the control points; the object points; the pixels (image, point, x, y, sd x, sd y).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.brown import BrownLens
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.network import IntArray, Pose


@dataclass(frozen=True, slots=True, eq=False)
class PhotoModelerProject:
    """What such an export holds; object space in the export's own unit.

    Attributes
    ----------
    lens
        The camera.
    files, poses
        Name and exterior orientation of each image.
    point_ids, points, point_sd
        Ids, (p, 3) coordinates and (p, 3) standard deviations of control and object points.
    image, point
        (n,) index of each pixel's image and point.
    image_px, sd_px
        (n, 2) pixels, centres at integers, and their standard deviations.
    """

    lens: BrownLens
    files: tuple[str, ...]
    poses: tuple[Pose, ...]
    point_ids: tuple[int, ...]
    points: FloatArray
    point_sd: FloatArray
    image: IntArray
    point: IntArray
    image_px: FloatArray
    sd_px: FloatArray


def read_photomodeler(text: str) -> PhotoModelerProject:
    """Read the text of an export.

    Pixels in it are half a pixel further than ours: its top-left pixel has its centre at (0.5, 0.5).

    Raises
    ------
    DataError
        The text is not such an export; the message names the line.
    """
    lines = text.splitlines()
    try:
        width, height = (int(float(value)) for value in lines[1].split()[-2:])
        lens = _lens([float(value) for value in lines[3].split()], (width, height))
        index, files, poses = 5, [], []
        while index < len(lines) and len(lines[index].split()) == 2:
            files.append(lines[index].split()[1].rsplit("/", 1)[-1])
            poses.append(_pose([float(value) for value in lines[index + 1].split()[1:]]))
            index += 6
        control, index = _table(lines, index, 7)
        points, index = _table(lines, index, 7)
        marks, index = _table(lines, index, 6)
    except (IndexError, ValueError) as exc:
        raise DataError(f"not a PhotoModeler text export ({exc})") from exc
    table = np.concatenate([control, points]) if len(control) else points
    # Control points are listed among the object points as well: keep each id once.
    ids, first = np.unique(table[:, 0].astype(int), return_index=True)
    place = {int(name): row for row, name in enumerate(ids)}
    unknown = sorted({int(mark) for mark in marks[:, 1]} - set(place))
    if unknown:
        raise DataError(f"pixels of points that are not listed: {unknown[:10]}")
    return PhotoModelerProject(
        lens,
        tuple(files),
        tuple(poses),
        tuple(int(i) for i in ids),
        table[first, 1:4],
        table[first, 4:7],
        marks[:, 0].astype(np.intp),
        np.array([place[int(mark)] for mark in marks[:, 1]], dtype=np.intp),
        marks[:, 2:4] - 0.5,
        marks[:, 4:6],
    )


def rotation_from_angles(omega: float, phi: float, kappa: float) -> FloatArray:
    """(3, 3) rotation, object to our camera axes, of photogrammetric angles in radians.

    Photogrammetric camera axes are x right, y up, z backward, and ``R = R3(kappa) R2(phi) R1(omega)``.
    """
    co, so, cp, sp, ck, sk = np.cos(omega), np.sin(omega), np.cos(phi), np.sin(phi), np.cos(kappa), np.sin(kappa)
    about_x = np.array([[1, 0, 0], [0, co, so], [0, -so, co]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_z = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    rotation: FloatArray = np.diag([1.0, -1.0, -1.0]) @ about_z @ about_y @ about_x
    return rotation


def _lens(numbers: list[float], image_size: tuple[int, int]) -> BrownLens:
    """Read the interior orientation; affinity is what the format's width has over square pixels."""
    c, px, py, format_width, format_height, k1, k2, k3, p1, p2 = numbers
    pixel = format_height / image_size[1]
    affinity = format_width / image_size[0] / pixel - 1.0
    return BrownLens(image_size, pixel, c, (px / (1.0 + affinity), py), affinity, (k1, k2, k3), (p1, p2))


def _pose(numbers: list[float]) -> Pose:
    """Read position and kappa, phi, omega in degrees."""
    kappa, phi, omega = np.radians(numbers[3:6])
    return Pose(rotation_from_angles(float(omega), float(phi), float(kappa)), np.array(numbers[:3]))


def _table(lines: list[str], index: int, width: int) -> tuple[FloatArray, int]:
    """Read rows of `width` numbers from the next non-empty line on, up to a line of another width."""
    while index < len(lines) and not lines[index].strip():
        index += 1
    rows = []
    while index < len(lines) and len(lines[index].split()) == width:
        rows.append([float(value) for value in lines[index].split()])
        index += 1
    return np.array(rows).reshape(-1, width), index
