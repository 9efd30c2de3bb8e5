"""Interior orientation of a camera from photographs of a board: a self-calibrating free-network adjustment.

Board and lens are adjusted together: a printed sheet is neither true to scale nor flat, and need not be. What the
adjustment says of the lens is as good as the photographs are different, so a set that leaves something open is named.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.blur import FloatArray
from labdaemon.errors import DataError
from labdaemon.geometry import (
    GrossError,
    Lens,
    Network,
    Pose,
    adjust_without_gross_errors,
    rotation_from_vector,
    select_observations,
)
from labdaemon.imaging import centre_shift
from labdaemon.processing.boards import BoardImage, CharucoBoard, charuco_image, sheet_dots, sheet_images

SUFFIXES = frozenset(
    f".{kind}"
    for kind in (
        *("nef", "nrw", "dng", "cr2", "cr3", "crw", "arw", "raf", "rw2", "orf", "pef", "srw", "3fr", "iiq"),
        *("tif", "tiff", "png", "jpg", "jpeg"),
    )
)
FEWEST_PHOTOGRAPHS = 4  # three fix the lens in theory, with nothing left to show a mistake
SD_PX = 0.1
"""A detected centre or corner, before the residuals say better."""
MOST_GROSS_ERRORS = 60  # beyond this the board is not what was stated
FEW_PHOTOGRAPHS = 8  # with fewer the corners of the frame are seldom seen
ROLLED_DEG, TILTED_DEG = 60.0, 25.0
"""Largest difference of roll, and of viewing direction, that a good set has at least."""
CORNER = 0.2
"""Part of the frame's width and height that is its corner."""
WEAK_FOCAL, WEAK_CENTRE_PX = 1e-3, 2.0
"""Relative standard deviation of the focal length, and the principal point's, from which a set is weak."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """A camera's interior orientation and what it rests on.

    Attributes
    ----------
    lens, sd
        OpenCV's model, and (9,) standard deviations in the order of `geometry.lens.INTERIOR_NAMES`.
    sigma0_px, degrees_of_freedom
        Standard deviation of a measured image coordinate, and how many were superfluous.
    files
        Photographs used.
    image_px, residuals_px, photograph
        (n, 2) points and residuals (measured minus computed), and (n,) which file each is of.
    left_out
        Photographs and points not used, with the reason.
    warnings
        What the set of photographs leaves open.
    """

    lens: Lens
    sd: FloatArray
    sigma0_px: float
    degrees_of_freedom: int
    files: tuple[Path, ...]
    image_px: FloatArray
    residuals_px: FloatArray
    photograph: NDArray[np.intp]
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]


def board_files(folder: Path) -> list[Path]:
    """Photographs in a folder, by name.

    Raises
    ------
    DataError
        The folder is missing, or holds fewer than `FEWEST_PHOTOGRAPHS` photographs.
    """
    if not os.path.isdir(folder):
        raise DataError("no such folder", file=folder)
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if len(files) < FEWEST_PHOTOGRAPHS:
        raise DataError(
            f"holds {len(files)} photographs; at least {FEWEST_PHOTOGRAPHS} of the board are needed", file=folder
        )
    return files


def read_board(
    files: Sequence[Path],
    charuco: CharucoBoard | None = None,
    *,
    jpeg: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[list[BoardImage], list[str]]:
    """Find the board in every photograph.

    Parameters
    ----------
    files
        Photographs of one camera at one focus.
    charuco
        The board; a sheet of dots with coded rings when None.
    jpeg
        Take JPEGs.
    progress
        Called with the number done and the number of all.

    Returns
    -------
    tuple
        What the photographs show, and a line for each that shows too little.

    Raises
    ------
    DataError
        A file cannot be read, is of another size or body than the first, or too few show the board.
    """
    found: list[BoardImage] = []
    sheets = []
    for done, file in enumerate(files, start=1):
        if charuco is not None:
            photograph = charuco_image(file, charuco, jpeg=jpeg)
            found += [photograph] if photograph is not None else []
        else:
            sheets.append(sheet_dots(file, jpeg=jpeg))
        if progress is not None:
            progress(done, len(files))
    if charuco is None:
        found = sheet_images(sheets)
    if len(found) < FEWEST_PHOTOGRAPHS:
        raise DataError(
            f"the board was recognised in {len(found)} of {len(files)} photographs; {FEWEST_PHOTOGRAPHS} are needed",
            file=files[0].parent,
        )
    first = found[0]
    for photograph in found:
        if photograph.size != first.size:
            raise DataError(
                "is {} × {} px, {} is {} × {} px: one camera and one format at a time".format(
                    *photograph.size, first.file.name, *first.size
                ),
                file=photograph.file,
            )
        if photograph.serial and first.serial and photograph.serial != first.serial:
            raise DataError(
                f"is from body {photograph.serial}, {first.file.name} from {first.serial}: one camera at a time",
                file=photograph.file,
            )
    used = {photograph.file for photograph in found}
    return found, [f"{file.name}: the board was not recognised" for file in files if file not in used]


def calibrate(photographs: Sequence[BoardImage], notes: Sequence[str] = ()) -> CameraCalibration:
    """Adjust lens, board and camera positions to what the photographs show.

    Parameters
    ----------
    photographs
        From `read_board`.
    notes
        Photographs left out so far.

    Raises
    ------
    DataError
        The photographs do not determine the lens.
    """
    network, names = _network(photographs, *_initial_calibration(photographs))
    adjustment, _, gross = adjust_without_gross_errors(network, names, max_errors=MOST_GROSS_ERRORS)
    if any(np.any(photograph.radius_px > 0) for photograph in photographs):
        lens, poses = adjustment.network.lenses[0], adjustment.network.poses
        assert isinstance(lens, Lens)
        network, names = _network(_circle_centres(photographs, lens, poses), lens, poses)
        adjustment, _, gross = adjust_without_gross_errors(network, names, max_errors=MOST_GROSS_ERRORS)
    final = adjustment.network
    lens = final.lenses[0]
    assert isinstance(lens, Lens)
    files = tuple(photograph.file for photograph in photographs)
    return CameraCalibration(
        lens,
        adjustment.interior_sd(),
        adjustment.sigma0 * SD_PX,
        adjustment.degrees_of_freedom,
        files,
        final.image_px,
        adjustment.residuals_px,
        final.image,
        (*notes, *(left_out_line(error, files) for error in gross)),
        tuple(find_weaknesses(lens, adjustment.interior_sd(), final.poses, final.image_px)),
    )


def find_weaknesses(lens: Lens, sd: FloatArray, poses: Sequence[Pose], image_px: FloatArray) -> list[str]:
    """What a set of photographs leaves open, a line each.

    Parameters
    ----------
    lens, sd
        The result and its (9,) standard deviations.
    poses
        Where the photographs were taken from, in the board's axes.
    image_px
        (n, 2) all points in all of them.
    """
    found = []
    if len(poses) < FEW_PHOTOGRAPHS:
        found.append(f"only {len(poses)} photographs: take {FEW_PHOTOGRAPHS} or more")
    rolls = np.arctan2([p.rotation[1, 0] for p in poses], [p.rotation[0, 0] for p in poses])
    if np.abs(np.angle(np.exp(1j * (rolls[:, None] - rolls)))).max() < np.radians(ROLLED_DEG):
        found.append("no rolled views: turn the camera by 90° for some, or the principal point hangs on the board")
    axes = np.stack([p.rotation[2] for p in poses])
    apart = np.degrees(np.arccos(np.clip(axes @ axes.T, -1.0, 1.0)).max())
    if apart < TILTED_DEG:
        found.append(
            f"all views within {apart:.0f}°: tilt the board by 30° or more both ways, or the focal length is weak"
        )
    width, height = lens.image_size
    for name, x, y in (("top-left", 0, 0), ("top-right", 1, 0), ("bottom-left", 0, 1), ("bottom-right", 1, 1)):
        away = np.abs(image_px - np.array([x * width, y * height])) / np.array([width, height])
        if not np.any((away < CORNER).all(axis=1)):
            found.append(f"no point in the {name} corner of the frame: the distortion there is extrapolated")
    if not lens.covers_image:
        found.append("the lens model folds over within the frame: cover its corners and calibrate again")
    focal, centre = sd[:2].max() / min(lens.focal_px), sd[2:4].max()
    if focal > WEAK_FOCAL or centre > WEAK_CENTRE_PX:
        found.append(
            f"focal length known to {100 * focal:.2g} % and principal point to {centre:.2g} px only: add photographs"
        )
    return found


def _initial_calibration(photographs: Sequence[BoardImage]) -> tuple[Lens, tuple[Pose, ...]]:
    """Starting values by OpenCV's own calibration, which wants a flat board."""
    size = photographs[0].size
    boards = [np.column_stack([p.board, np.zeros(len(p.names))]).astype(np.float32) for p in photographs]
    images = [photograph.image_px.astype(np.float32) for photograph in photographs]
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(boards, images, size, None, None)
        matrix = np.asarray(matrix, dtype=float)
        k1, k2, p1, p2, k3 = (float(value) for value in np.asarray(distortion, dtype=float).ravel()[:5])
        lens = Lens(size, (matrix[0, 0], matrix[1, 1]), (matrix[0, 2], matrix[1, 2]), (k1, k2, p1, p2, k3))
    except (cv2.error, DataError) as exc:
        raise DataError(
            "no lens explains these photographs of the board: is it one board, one camera, one focus?",
            file=photographs[0].file.parent,
        ) from exc
    poses = []
    for turn, shift in zip(turns, shifts, strict=True):
        rotation = rotation_from_vector(np.asarray(turn, dtype=float).ravel())
        poses.append(Pose(rotation, -rotation.T @ np.asarray(shift, dtype=float).ravel()))
    return lens, tuple(poses)


def _network(photographs: Sequence[BoardImage], lens: Lens, poses: Sequence[Pose]) -> tuple[Network, tuple[str, ...]]:
    """Free network of all points seen twice, in steps of the board's grid."""
    place = {name: tuple(xy) for p in photographs for name, xy in zip(p.names, p.board.tolist(), strict=True)}
    names = tuple(sorted(place))
    index = {name: row for row, name in enumerate(names)}
    network = Network(
        (lens,),
        tuple(poses),
        np.zeros(len(poses), dtype=np.intp),
        np.array([[*place[name], 0.0] for name in names]),
        np.concatenate([np.full(len(p.names), k) for k, p in enumerate(photographs)]),
        np.array([index[name] for p in photographs for name in p.names], dtype=np.intp),
        np.concatenate([p.image_px for p in photographs]),
        SD_PX,
        free_interior=(np.ones(9, dtype=np.bool_),),
        datum=True,
    )
    return select_observations(network, names)


def _circle_centres(photographs: Sequence[BoardImage], lens: Lens, poses: Sequence[Pose]) -> list[BoardImage]:
    """Photographs with every dot's centre in place of its ellipse's, which differs from it under perspective."""
    result = []
    for photograph, pose in zip(photographs, poses, strict=True):
        board = np.column_stack([photograph.board, np.zeros(len(photograph.names))])
        local = (board - pose.position) @ pose.rotation.T
        radius = float(np.median(photograph.radius_px * local[:, 2])) / float(np.mean(lens.focal_px))
        normals = np.broadcast_to(pose.rotation[:, 2], local.shape)
        shift = centre_shift(local, normals, np.full(len(local), radius))
        pixels = np.einsum("nij,nj->ni", lens.distort_jacobian(local[:, :2] / local[:, 2:]), shift)
        result.append(replace(photograph, image_px=photograph.image_px + pixels))
    return result


def left_out_line(error: GrossError, files: Sequence[Path]) -> str:
    """Say which point of which photograph was left out."""
    return (
        f"{files[error.image].name}: point {error.point} left out, off by {error.size:.2f} px "
        f"({error.test:.0f} times its standard deviation)"
    )
