"""Flagged targets of a data-set folder as images for the page: what the camera saw, the model, and the difference.

Only flagged targets are shown, and only so many that the page stays small; the page counts the rest.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, zip_longest
from pathlib import Path

import cv2
import numpy as np

from labdaemon.blur import ExposureWindow
from labdaemon.errors import ConfigError, DataError
from labdaemon.imaging import LazyImage, read_frame
from labdaemon.orbit_size import semi_major_axis, size_mm
from labdaemon.processing import CaptureFacts, DataFolder, Row, open_folder
from labdaemon.report.remedies import remedy
from labdaemon.report.target_patch import CYCLE_NODES, FloatArray, PathWeights, modelled_patch, patch_strip

MAX_PATCHES = 24
"""Drawings on a page: some 0.1 MB."""
USUAL_RADIUS_PX = 16.0
"""Of a dot, where nothing shows how large it is in the frame."""
_SHOWN_NOT = frozenset({"at_rest"})


@dataclass(frozen=True, slots=True)
class FlaggedPatch:
    """A drawing of a flagged target.

    Attributes
    ----------
    name
        Capture, camera and target.
    flags
        Its flags, comma-separated.
    remedy
        What to do.
    data_uri
        The drawing as PNG.
    has_model
        Whether model and difference are on it, right of the image.
    """

    name: str
    flags: str
    remedy: str
    data_uri: str
    has_model: bool


@dataclass(frozen=True, slots=True)
class FlaggedPatches:
    """What the page shows.

    Attributes
    ----------
    patches
        The drawings.
    others
        Flagged readings of a camera that are not drawn.
    """

    patches: tuple[FlaggedPatch, ...] = ()
    others: int = 0


def flagged_patches(
    folder: Path,
    measurements: Sequence[Row],
    envelopes: Mapping[str, Sequence[Row]],
    facts: Mapping[str, CaptureFacts],
    *,
    most: int = MAX_PATCHES,
) -> FlaggedPatches:
    """Draw flagged targets, each kind of flag in turn.

    Parameters
    ----------
    folder
        The data-set folder. A frame that is not there, or cannot be read, leaves its targets without a drawing.
    measurements
        Rows of `measurements.csv`.
    envelopes
        Rows of `envelope.csv` by capture: their flags count, too.
    facts
        From `capture_facts`.
    most
        Drawings.
    """
    flagged = _in_turn(_flagged(measurements, envelopes))
    try:
        opened = open_folder(folder)
    except (DataError, ConfigError):  # results without their frames: the table of flags says what there is to say
        return FlaggedPatches((), len(flagged))
    frames = _Frames(opened, facts)
    places, radius = _usual_places(measurements), _radii_px(opened, measurements, envelopes)
    drawn: list[FlaggedPatch] = []
    for row, flags in sorted(flagged[:most], key=lambda one: (str(one[0]["capture"]), str(one[0]["camera"]))):
        camera, target = str(row["camera"]), str(row["target"])
        centre = _pair(row, "x_px", "y_px")
        centre = places.get((camera, target)) if centre is None else centre
        strip = None if centre is None else frames.strip(row, centre, radius.get(camera, USUAL_RADIUS_PX))
        if strip is not None:
            what = " ".join(text for flag in flags if (text := remedy(flag)))
            name = f"{row['capture']} · {camera} · {target}"
            drawn.append(FlaggedPatch(name, ", ".join(flags), what, *strip))
    return FlaggedPatches(tuple(drawn), len(flagged) - len(drawn))


class _Frames:
    """Frames of a folder, read when a target in them is drawn; the last blurred one is kept, as rows come in order."""

    def __init__(self, folder: DataFolder, facts: Mapping[str, CaptureFacts]) -> None:
        self._folder, self._facts = folder, facts
        self._kept: dict[str, tuple[Path, LazyImage]] = {}

    def strip(self, row: Row, centre: FloatArray, radius_px: float) -> tuple[str, bool] | None:
        """PNG of a target as a data URI, and whether the model is on it; None where a frame cannot be read."""
        name, camera = str(row["capture"]), str(row["camera"])
        known = self._facts.get(name, CaptureFacts())
        try:
            capture = self._folder.capture(known.captures[-1] if known.captures else name)
            blurred = self._grey("blurred", capture.frames[camera])
            a, b = _pair(row, "ax_px", "ay_px"), _pair(row, "bx_px", "by_px")
            path = None
            if a is not None:
                window = capture.about.window(camera) if known.is_phase_known else None
                path = _path(a, np.zeros(2) if b is None else b, window)
            half = round(1.6 * radius_px + 1.2 * (path.reach_px if path is not None else radius_px) + 4)
            seen = _cut(blurred, centre, half)
            if seen is None:
                return None
            model = None
            if path is not None:
                sharp = self._grey(f"sharp {camera}", self._folder.sharp(capture.about.sharp).frames[camera][0])
                still = _cut(sharp, centre, half)
                model = None if still is None else modelled_patch(still, path, seen)
        except (DataError, ConfigError):
            return None
        _, data = cv2.imencode(".png", patch_strip(seen, model), [cv2.IMWRITE_PNG_COMPRESSION, 9])
        return f"data:image/png;base64,{base64.b64encode(data.tobytes()).decode()}", model is not None

    def _grey(self, key: str, file: Path) -> LazyImage:
        kept = self._kept.get(key)
        if kept is None or kept[0] != file:
            self._kept[key] = (file, read_frame(file).lazy_grey())
        return self._kept[key][1]


def _flagged(
    measurements: Sequence[Row], envelopes: Mapping[str, Sequence[Row]]
) -> Iterator[tuple[Row, tuple[str, ...]]]:
    """Rows of cameras with a flag of their own, or whose target has one in the envelope that no camera has."""
    joined = {
        (capture, str(row["target"])): _flags(row) for capture, rows in envelopes.items() for row in rows if _flags(row)
    }
    own: dict[tuple[str, str], set[str]] = {}
    for row in measurements:
        own.setdefault((str(row["capture"]), str(row["target"])), set()).update(_flags(row))
    for row in measurements:
        key = str(row["capture"]), str(row["target"])
        if key in joined:
            flags = (*_flags(row), *(flag for flag in joined[key] if flag not in own[key]))
            if flags:
                yield row, flags


def _in_turn(flagged: Iterator[tuple[Row, tuple[str, ...]]]) -> list[tuple[Row, tuple[str, ...]]]:
    """One of each kind of flag, then the second of each, and so on: a common flag leaves room for a rare one."""
    kinds: dict[tuple[str, ...], list[tuple[Row, tuple[str, ...]]]] = {}
    for row, flags in flagged:
        kinds.setdefault(flags, []).append((row, flags))
    return [one for one in chain.from_iterable(zip_longest(*kinds.values())) if one is not None]


def _flags(row: Row) -> tuple[str, ...]:
    flags = row["flags"]
    return tuple(flag for flag in flags if flag not in _SHOWN_NOT) if isinstance(flags, list) else ()


def _path(a: FloatArray, b: FloatArray, window: ExposureWindow | None) -> PathWeights:
    """The path as the exposure saw it; over whole cycles where the phase is not known."""
    whole = 2 * np.pi * (np.arange(4 * CYCLE_NODES) + 0.5) / (4 * CYCLE_NODES)
    if window is None:
        return PathWeights.of(a, b)
    if window.light is not None:
        return PathWeights.of(a, b, whole, window.light.at(whole) + window.light.ambient)
    if window.phase_rad is None:
        return PathWeights.of(a, b)
    count = max(round(CYCLE_NODES * min(window.cycles, 8.0)), CYCLE_NODES)
    return PathWeights.of(a, b, window.phase_rad + 2 * np.pi * window.cycles * (np.arange(count) + 0.5) / count)


def _usual_places(measurements: Sequence[Row]) -> dict[tuple[str, str], FloatArray]:
    """Where each camera sees each target on the whole: a place for what was not found."""
    seen: dict[tuple[str, str], list[FloatArray]] = {}
    for row in measurements:
        centre = _pair(row, "x_px", "y_px")
        if centre is not None:
            seen.setdefault((str(row["camera"]), str(row["target"])), []).append(centre)
    return {key: np.median(centres, axis=0) for key, centres in seen.items()}


def _radii_px(
    folder: DataFolder, measurements: Sequence[Row], envelopes: Mapping[str, Sequence[Row]]
) -> dict[str, float]:
    """Radius of the largest dots in each camera, by what pixels and millimetres its motions have."""
    size = {(capture, str(row["target"])): size_mm(row) for capture, rows in envelopes.items() for row in rows}
    ratios: dict[str, list[float]] = {}
    for row in measurements:
        a, b = _pair(row, "ax_px", "ay_px"), _pair(row, "bx_px", "by_px")
        true = size.get((str(row["capture"]), str(row["target"])))
        if a is not None and true and not row["flags"]:
            pixels = semi_major_axis(a.tolist(), (np.zeros(2) if b is None else b).tolist())
            ratios.setdefault(str(row["camera"]), []).append(pixels / true)
    radius_mm = max(folder.rig.targets.diameter_mm) / 2
    # Motion along the camera's axis is foreshortened: the upper quartile is nearer to the scale than the median.
    return {camera: radius_mm * float(np.quantile(values, 0.75)) for camera, values in ratios.items()}


def _pair(row: Row, x: str, y: str) -> FloatArray | None:
    values = row[x], row[y]
    return np.array(values, dtype=float) if all(isinstance(value, float) for value in values) else None


def _cut(grey: LazyImage, centre: FloatArray, half: int) -> FloatArray | None:
    """A square around a place; None where it leaves the frame."""
    x, y = (round(float(value)) for value in centre)
    height, width = grey.shape
    if x - half < 0 or y - half < 0 or x + half >= width or y + half >= height:
        return None
    return np.asarray(grey[y - half : y + half + 1, x - half : x + half + 1], float)
