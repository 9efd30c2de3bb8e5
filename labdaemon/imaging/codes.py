"""Square coded targets (AprilTag, ArUco): read by OpenCV, measured on the mosaic by their sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError, UsageError
from labdaemon.imaging.edges import corners_of, fit_side
from labdaemon.imaging.frame import RawFrame

FloatArray = NDArray[np.float64]

MIN_CONTRAST = 0.35
"""Least part of the paper's brightness by which every side of a tag is darker."""


@dataclass(frozen=True, slots=True, eq=False)
class Tag:
    """A square coded target in a frame.

    Attributes
    ----------
    name
        Its number in the family, as text: the name in `control.csv`.
    centre_px
        (2,) intersection of the diagonals. On a lens with distortion use `centre_of` with the undistorted corners.
    corners_px
        (4, 2) outer corners of the black square, clockwise in the image from the tag's own top-left.
    covariance_px2
        (8, 8) of the corners' x0, y0, x1 …; NaN where the sides could not be fitted and OpenCV's corners stay.
    """

    name: str
    centre_px: FloatArray
    corners_px: FloatArray
    covariance_px2: FloatArray

    @property
    def measured(self) -> bool:
        """True when all four sides were fitted."""
        return bool(np.isfinite(self.covariance_px2).all())

    @property
    def sd_px(self) -> float:
        """Standard deviation of the centre, mean of both coordinates; NaN where the sides could not be fitted."""
        moves = np.empty((2, 8))
        for k in range(8):
            nudge = np.zeros((4, 2))
            nudge[divmod(k, 2)] = 0.01
            moves[:, k] = (centre_of(self.corners_px + nudge) - centre_of(self.corners_px - nudge)) / 0.02
        return float(np.sqrt(np.trace(moves @ self.covariance_px2 @ moves.T) / 2.0))


def centre_of(corners: FloatArray) -> FloatArray:
    """(2,) intersection of the diagonals of (4, 2) corners: the image of a square's centre under any perspective.

    Under lens distortion straight lines are not straight, so undistort the corners first: at the border of a wide lens
    the centre of a 100 px tag otherwise moves by a tenth of a pixel.
    """
    p, q, r, s = corners
    along = np.stack([r - p, -(s - q)], axis=1)
    t = np.linalg.solve(along, q - p)[0]
    return np.asarray(p + t * (r - p))


def families() -> dict[str, int]:
    """Names of the families that can be read, as in `[control] family`, and OpenCV's number of each."""
    found: dict[str, int] = {}
    for constant in sorted(dir(cv2.aruco)):
        if not constant.startswith("DICT_") or constant != constant.upper():
            continue
        words = constant.removeprefix("DICT_").lower().split("_")
        words = words if words[0] in ("apriltag", "aruco") else ["aruco", *words]
        found["-".join(words)] = int(getattr(cv2.aruco, constant))
    return found


def dictionary(family: str) -> cv2.aruco.Dictionary:
    """OpenCV's code book of a family.

    Raises
    ------
    UsageError
        No such family; the message lists those there are.
    """
    known = families()
    if family not in known:
        raise UsageError(f"no tag family {family!r}; there are {', '.join(known)}")
    return cv2.aruco.getPredefinedDictionary(known[family])


def find_tags(frame: RawFrame, family: str = "apriltag-36h11") -> list[Tag]:
    """Find the tags of one family in a frame.

    Parameters
    ----------
    frame
        A sharp frame, or a blurred one of which the control targets did not move.
    family
        A key of `families()`.

    Returns
    -------
    Tags by number; the same number twice if two such tags are in view (see `by_name`). Every side must show dark ink
    against white paper, which refuses what only resembles a code.

    Raises
    ------
    UsageError
        No such family.
    """
    book = dictionary(family)
    cells = book.markerSize + 2
    found: list[Tag] = []
    for number, rough in _read(frame, book):
        if any(tag.name == str(number) and _near(tag, rough) for tag in found):
            continue
        tag = _measure(frame, number, rough, cells)
        if tag is not None:
            found.append(tag)
    found.sort(key=lambda tag: (int(tag.name), tag.centre_px[1], tag.centre_px[0]))
    return found


def by_name(tags: Sequence[Tag], *, where: str = "the frame") -> dict[str, Tag]:
    """Tags keyed by name.

    Raises
    ------
    DataError
        A name occurs twice: two prints of one tag in view, so the two cannot be distinguished.
    """
    result: dict[str, Tag] = {}
    for tag in tags:
        if tag.name in result:
            places = " and ".join(f"({t.centre_px[0]:.0f}, {t.centre_px[1]:.0f})" for t in (result[tag.name], tag))
            raise DataError(f"tag {tag.name} is in view twice, at {places} px; cover or remove one", file=where)
        result[tag.name] = tag
    return result


def _near(tag: Tag, corners: FloatArray) -> bool:
    size = np.hypot(*(tag.corners_px[0] - tag.corners_px[2]))
    return bool(np.hypot(*(tag.centre_px - corners.mean(axis=0))) < size / 4.0)


def _read(frame: RawFrame, book: cv2.aruco.Dictionary) -> list[tuple[int, FloatArray]]:
    """(number, (4, 2) corners within about a pixel) as OpenCV sees them, at full and at half resolution.

    A slight blur takes out the mosaic's pattern, hot pixels and noise; half resolution lets large tags fit the adaptive
    threshold's windows.
    """
    light = cv2.sqrt(np.maximum(frame.grey(), 0.0))
    peak = float(np.percentile(light[::7, ::7], 99.5)) or 1.0
    full = cv2.GaussianBlur(cv2.convertScaleAbs(light, alpha=255.0 / peak), (0, 0), 0.8)
    half = cv2.resize(full, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.minMarkerPerimeterRate = 80.0 / max(full.shape)
    # At its default OpenCV drops a tag for the outline of the card it is printed on; twins are sorted out here.
    settings.minMarkerDistanceRate = 0.02
    detector = cv2.aruco.ArucoDetector(book, settings)
    found: list[tuple[int, FloatArray]] = []
    for image, back in ((full, _identity), (half, _doubled)):
        corners, numbers, _ = detector.detectMarkers(image)
        if numbers is not None:
            found += [
                (int(n), back(c.reshape(4, 2).astype(np.float64)))
                for n, c in zip(np.ravel(numbers), corners, strict=True)
            ]
    return found


def _identity(points: FloatArray) -> FloatArray:
    return points


def _doubled(points: FloatArray) -> FloatArray:
    return 2.0 * points + 0.5


def _measure(frame: RawFrame, number: int, rough: FloatArray, cells: int) -> Tag | None:
    """Fit the four sides, twice, the second time from the first one's corners; None if it is no tag."""
    corners, covariance = rough, np.full((8, 8), np.nan)
    for _ in range(2):
        low, high = np.floor(corners.min(axis=0)).astype(int) - 8, np.ceil(corners.max(axis=0)).astype(int) + 9
        patch = frame.patch(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
        sides = []
        for k in range(4):
            start, end = corners[k], corners[(k + 1) % 4]
            cell = float(np.hypot(*(end - start))) / cells
            band = float(np.clip(0.45 * cell, 2.0, 4.0))
            sides.append(fit_side(patch, start, end, band_px=band, guard_px=max(0.5 * cell, band)))
        fitted = [side for side in sides if side is not None]
        if any(side.contrast < MIN_CONTRAST for side in fitted):
            return None
        if len(fitted) < 4:
            break
        met = corners_of(fitted)
        if met is None or np.hypot(*(met[0] - corners).T).max() > 4.0:
            break
        corners, covariance = met
    return Tag(str(number), centre_of(corners), corners, covariance)
