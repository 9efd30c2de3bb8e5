"""A frame with its vectors drawn over it, magnified, as Fig. 10 of McCarthy, Chandler and Palmeri (2016)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.durable import write_durably
from labdaemon.imaging import Grey, read_frame
from labdaemon.orbit_size import semi_major_axis, size_mm
from labdaemon.processing import FolderResult, Row
from labdaemon.report.figures import round_down
from labdaemon.report.label_places import LabelPlacer

READABLE_SHARE = 0.11
"""Share of the image's longest side that the largest semi-amplitude fills at most; at 20 times, as in the paper, 1 m
away with a 24 mm lens, that is 5 mm."""
LARGEST_MAGNIFICATION = 1000.0
"""Beyond it only noise would be drawn."""
WIDEST_PX = 1800
"""Longest side of the image for the screen, px; the vectors' places scale with it."""

Colour = tuple[int, int, int]
Image = NDArray[np.uint8]

# Blue, green, red. Blue against orange differs for all kinds of colour vision; what is flagged has a "?" as well, and
# what was not measured is a cross.
CLEAN: Colour = (255, 200, 86)
FLAGGED: Colour = (0, 160, 255)
RESTING: Colour = (66, 228, 240)
LOST: Colour = (20, 80, 230)
COLOURS: dict[str, Colour] = {"clean": CLEAN, "at rest": RESTING, "flagged": FLAGGED, "not measured": LOST}
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_overlay(
    grey: Grey,
    rows: Sequence[Row],
    *,
    title: str,
    lengths_mm: Mapping[str, float] | None = None,
    magnify: float | None = None,
) -> Image:
    """Draw the measurements of one frame over it.

    Parameters
    ----------
    grey
        (h, w) the blurred frame, 0 to 1, linear.
    rows
        Its rows of `measurements.csv`.
    title
        Written along the top.
    lengths_mm
        Amplitude of each target in millimetres, written next to it where known, else pixels.
    magnify
        Of the vectors; one at which the largest is readable where it is not given.

    Returns
    -------
    array
        (h', w', 3) 8-bit image, blue, green, red.
    """
    scale = min(1.0, WIDEST_PX / max(grey.shape))
    factor = readable_magnification(rows, max(grey.shape)) if magnify is None else magnify
    image = _backdrop(grey, scale)
    unit = max(image.shape[:2]) / 1000
    drawn = [_DrawnMotion.of(row, scale, factor, lengths_mm) for row in rows if _pair(row, "x_px", "y_px") is not None]
    for motion in drawn:
        motion.draw(image, unit)
    everything = [motion.points(unit) for motion in drawn]
    placer = LabelPlacer(image.shape[1::-1], 46 * unit, np.concatenate([np.empty((0, 2)), *everything]))
    for motion in drawn:
        motion.label(image, unit, placer)
    amplitude = "semi-amplitude in mm" if lengths_mm is not None else "semi-amplitude in px"
    _caption(image, f"{title}   vectors x {factor:g}, {amplitude}", rows, unit)
    return image


def readable_magnification(rows: Sequence[Row], longest_px: float) -> float:
    """A round factor at which the largest motion without a doubt is readable; 1 where nothing moves.

    Parameters
    ----------
    rows
        Of `measurements.csv`.
    longest_px
        Longest side of the frame.
    """
    sizes = {kind: [size for row in rows if _kind(row) == kind and (size := _size_px(row))] for kind in COLOURS}
    largest = max(sizes["clean"] or sizes["flagged"] or sizes["at rest"], default=0.0)
    if largest <= 0:
        return 1.0
    return min(max(round_down(READABLE_SHARE * longest_px / largest), 1.0), LARGEST_MAGNIFICATION)


def write_overlay(
    frame: Path,
    rows: Sequence[Row],
    out: Path,
    title: str,
    lengths_mm: Mapping[str, float] | None = None,
    capture_rows: Sequence[Row] | None = None,
) -> None:
    """Draw a frame's measurements and write the image as PNG; one task for a worker.

    Parameters
    ----------
    frame, out
        The frame, and the image.
    rows, title, lengths_mm
        As for `draw_overlay`.
    capture_rows
        Rows of all cameras of the capture, which then have one magnification; `rows` if None.

    Raises
    ------
    DataError
        The frame cannot be read or the image not written.
    """
    grey = read_frame(frame).grey()
    factor = readable_magnification(rows if capture_rows is None else capture_rows, max(grey.shape))
    image = draw_overlay(grey, rows, title=title, lengths_mm=lengths_mm, magnify=factor)
    ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 4])
    if ok:
        write_durably(out, data.tobytes())


def overlay_path(out: Path, capture: str, camera: str) -> Path:
    """Where the image of a capture (or group) and camera lies in a results folder."""
    return out / "overlay" / (f"{capture}-{camera}.png" if camera else f"{capture}.png")


def write_overlays(folder: Path, result: FolderResult, submit: Callable[..., Future[None]]) -> list[Future[None]]:
    """Start drawing every capture of a processed folder, an image a camera.

    Parameters
    ----------
    folder
        The data-set folder.
    result
        From `process_folder`.
    submit
        Runs a function with its arguments, as `WorkerPool.submit`.
    """
    tasks = []
    for capture in result.captures:
        lengths = {str(row["target"]): length for row in capture.envelope_rows if (length := size_mm(row)) is not None}
        for camera, frame in capture.frames:
            rows = [row for row in capture.measurement_rows if row["camera"] == camera]
            title = f"{capture.name}  {camera}"
            out = overlay_path(result.out, capture.name, camera)
            tasks.append(submit(write_overlay, folder / frame, rows, out, title, lengths, capture.measurement_rows))
    return tasks


def _kind(row: Row) -> str:
    """Which of the colours' names a row goes under."""
    if row["ax_px"] is None:
        return "not measured"
    if row["flags"] == ["at_rest"]:
        return "at rest"
    return "flagged" if row["flags"] else "clean"


def _backdrop(grey: Grey, scale: float) -> Image:
    """The frame as one would see it: brightest paper white, tone curve of a screen, a little dimmed."""
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA) if scale < 1 else grey
    white = max(float(np.percentile(small, 99.5)), 1e-6)
    tone = np.clip(small / white, 0.0, 1.0) ** (1 / 2.2)
    return cast(Image, cv2.cvtColor((tone * 200).astype(np.uint8), cv2.COLOR_GRAY2BGR))


def _pair(row: Row, x: str, y: str) -> NDArray[np.float64] | None:
    values = row[x], row[y]
    return np.array(values, dtype=float) if all(isinstance(value, float) for value in values) else None


@dataclass(frozen=True, slots=True, eq=False)
class _DrawnMotion:
    """A target in pixels of the drawing: (2,) mean position, semi-axes magnified, and the major one as it is."""

    at: NDArray[np.float64]
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    blur: NDArray[np.float64]
    kind: str
    text: str

    @classmethod
    def of(cls, row: Row, scale: float, magnify: float, lengths_mm: Mapping[str, float] | None) -> _DrawnMotion:
        centre, kind, target = _pair(row, "x_px", "y_px"), _kind(row), str(row["target"])
        assert centre is not None
        at, rest = (centre + 0.5) * scale - 0.5, np.zeros(2)
        a, b = _pair(row, "ax_px", "ay_px"), _pair(row, "bx_px", "by_px")
        if a is None:
            return cls(at, rest, rest, rest, kind, target)
        b = rest if b is None else b
        length = None if lengths_mm is None else lengths_mm.get(target)
        size = f"{semi_major_axis(a.tolist(), b.tolist()):.2f} px" if length is None else f"{length:.2f}"
        text = f"{target} {size}" + (" ?" if kind == "flagged" else "")
        return cls(at, a * scale * magnify, b * scale * magnify, a * scale, kind, text)

    def draw(self, image: Image, unit: float) -> None:
        colour = COLOURS[self.kind]
        if self.kind == "not measured":
            cv2.drawMarker(image, _point(self.at), LOST, cv2.MARKER_TILTED_CROSS, round(14 * unit), _thick(unit))
            return
        inks = ((_thick(unit) + 2, (0, 0, 0)), (_thick(unit), colour))
        if math.hypot(*self.b) > 2 * unit:
            phase = np.linspace(0, 2 * np.pi, 73)
            path = self.at + np.outer(np.sin(phase), self.a) + np.outer(np.cos(phase), self.b)
            for width, ink in inks:
                cv2.polylines(image, [np.rint(path).astype(np.int32)], True, ink, width, cv2.LINE_AA)
        tip = min(0.3, 9 * unit / max(math.hypot(*self.a), 1e-9))
        for width, ink in inks:
            for end in (self.at + self.a, self.at - self.a):
                cv2.arrowedLine(image, _point(self.at), _point(end), ink, width, cv2.LINE_AA, 0, tip)
        cv2.circle(image, _point(self.at), max(2, round(2.2 * unit)), colour, -1, cv2.LINE_AA)

    def points(self, unit: float) -> NDArray[np.float64]:
        """(n, 2) points that no name should cover: the blur and its surroundings, vector, orbit."""
        phase = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        around = np.column_stack([np.cos(phase), np.sin(phase)]) * 8 * unit
        blur = np.concatenate([self.at + end * self.blur + ring for end in (-1, 0, 1) for ring in (around, around / 2)])
        vector = self.at + np.outer(np.linspace(-1, 1, 41), self.a)
        orbit = self.at + np.outer(np.sin(phase), self.a) + np.outer(np.cos(phase), self.b)
        return np.concatenate([blur, vector, orbit])

    def label(self, image: Image, unit: float, placer: LabelPlacer) -> None:
        """Write the name where it covers least: beyond the vector's ends, else above or below the blur."""
        if self.kind == "not measured":
            return
        size = 0.42 * unit
        width, height = _text_size(self.text, size)
        right = self.a if self.a[0] >= 0 else -self.a
        gap, half = 6 * unit, height / 2
        ends = [
            (self.at[0] + right[0] + gap, self.at[1] + right[1] - half),
            (self.at[0] - right[0] - gap - width, self.at[1] - right[1] - half),
        ]
        reach = max(abs(self.blur[1]), abs(self.a[1]), abs(self.b[1])) + 10 * unit
        sides = [
            (self.at[0] + dx, self.at[1] + dy)
            for dx in (-width / 2, 12 * unit, -12 * unit - width)
            for dy in (reach, -reach - height)
        ]
        corner = placer.place([*ends, *sides], width, height)
        _write(image, self.text, np.array([corner[0], corner[1] + height]), size)


def _size_px(row: Row) -> float:
    """Semi-major axis, px; 0 where it was not measured."""
    a, b = _pair(row, "ax_px", "ay_px"), _pair(row, "bx_px", "by_px")
    return 0.0 if a is None else semi_major_axis(a.tolist(), (np.zeros(2) if b is None else b).tolist())


def _point(at: NDArray[np.float64]) -> tuple[int, int]:
    limit = 30_000  # OpenCV takes no more
    return int(np.clip(round(float(at[0])), -limit, limit)), int(np.clip(round(float(at[1])), -limit, limit))


def _thick(unit: float) -> int:
    return max(1, round(1.4 * unit))


def _text_size(text: str, size: float) -> tuple[int, int]:
    (width, height), _ = cv2.getTextSize(text, _FONT, max(size, 0.35), 1)
    return int(width), int(height)


def _write(image: Image, text: str, at: NDArray[np.float64], size: float, colour: Colour = (255, 255, 255)) -> int:
    """Write on a darkened patch of the image; return the width taken, px."""
    size = max(size, 0.35)
    (width, height), below = cv2.getTextSize(text, _FONT, size, 1)
    x, y = _point(at)
    patch = image[max(y - height - 2, 0) : max(y + below, 0), max(x - 2, 0) : max(x + width + 2, 0)]
    patch //= 3
    cv2.putText(image, text, (x, y), _FONT, size, colour, 1, cv2.LINE_AA)
    return int(width)


def _caption(image: Image, title: str, rows: Sequence[Row], unit: float) -> None:
    """Title, and what the colours mean with how many there are of each, on a band of their own along the top."""
    band = round(46 * unit)
    image[:band] = image[:band] // 4
    _write(image, title, np.array([10, 18]) * unit, 0.55 * unit)
    counts = Counter(_kind(row) for row in rows)
    x = 10.0 * unit
    for kind, colour in COLOURS.items():
        if counts[kind]:
            x += _write(image, f"{counts[kind]} {kind}", np.array([x, 38 * unit]), 0.5 * unit, colour) + 24 * unit
