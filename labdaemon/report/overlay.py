"""A frame with its vectors drawn over it, magnified, as Fig. 10 of McCarthy, Chandler and Palmeri (2016)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from labdaemon.durable import write_durably
from labdaemon.imaging import Grey, read_frame
from labdaemon.orbit_size import semi_major_axis
from labdaemon.processing import FolderResult, Row

MAGNIFICATION = 20.0  # 0.1 mm shows as 2 mm
WIDEST_PX = 1800
"""Longest side of the image for the screen, px; the vectors' places scale with it."""

Colour = tuple[int, int, int]
Image = NDArray[np.uint8]

# Colours that differ in lightness too, so that they differ on a grey print, too (blue, green, red).
CLEAN: Colour = (60, 220, 90)
FLAGGED: Colour = (40, 170, 255)
RESTING: Colour = (230, 190, 70)
LOST: Colour = (60, 60, 255)
COLOURS: dict[str, Colour] = {"clean": CLEAN, "at rest": RESTING, "flagged": FLAGGED, "not measured": LOST}
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_overlay(
    grey: Grey, rows: Sequence[Row], *, title: str, lengths_mm: Mapping[str, float] | None = None
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

    Returns
    -------
    array
        (h', w', 3) 8-bit image, blue, green, red.
    """
    scale = min(1.0, WIDEST_PX / max(grey.shape))
    image = _backdrop(grey, scale)
    unit = max(image.shape[:2]) / 1000
    for row in rows:
        centre = _pair(row, "x_px", "y_px")
        if centre is None:
            continue
        colour = COLOURS[_kind(row)]
        a, b = _pair(row, "ax_px", "ay_px"), _pair(row, "bx_px", "by_px")
        at = (centre + 0.5) * scale - 0.5
        if a is None:
            cv2.drawMarker(image, _point(at), LOST, cv2.MARKER_TILTED_CROSS, round(14 * unit), _thick(unit))
            continue
        b = np.zeros(2) if b is None else b
        _draw_motion(image, at, a * scale * MAGNIFICATION, b * scale * MAGNIFICATION, colour, unit)
        target = str(row["target"])
        length = None if lengths_mm is None else lengths_mm.get(target)
        text = (
            f"{target} {semi_major_axis(a.tolist(), b.tolist()):.2f} px" if length is None else f"{target} {length:.2f}"
        )
        _write(image, text, at + np.array([6, 16]) * unit, 0.42 * unit)
    _caption(image, title, rows, unit, has_mm=lengths_mm is not None)
    return image


def write_overlay(
    frame: Path, rows: Sequence[Row], out: Path, title: str, lengths_mm: Mapping[str, float] | None = None
) -> None:
    """Draw a frame's measurements and write the image as PNG; one task for a worker.

    Raises
    ------
    DataError
        The frame cannot be read or the image not written.
    """
    image = draw_overlay(read_frame(frame).grey(), rows, title=title, lengths_mm=lengths_mm)
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
        lengths = {
            str(row["target"]): length for row in capture.envelope_rows if (length := _length_mm(row)) is not None
        }
        for camera, frame in capture.frames:
            rows = [row for row in capture.measurement_rows if row["camera"] == camera]
            title = f"{capture.name}  {camera}"
            out = overlay_path(result.out, capture.name, camera)
            tasks.append(submit(write_overlay, folder / frame, rows, out, title, lengths))
    return tasks


def _kind(row: Row) -> str:
    """Which of the colours' names a row goes under."""
    if row["ax_px"] is None:
        return "not measured"
    if row["flags"] == ["at_rest"]:
        return "at rest"
    return "flagged" if row["flags"] else "clean"


def _length_mm(row: Row) -> float | None:
    """Major semi-axis of an envelope row's orbit."""
    values = [row[f"{axis}{k}_mm"] for axis in "ab" for k in "xyz"]
    if any(not isinstance(value, float) for value in values):
        return None
    a, b = np.array(values[:3], dtype=float), np.array(values[3:], dtype=float)
    return float(np.linalg.svd(np.stack([a, b]), compute_uv=False)[0])


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


def _draw_motion(
    image: Image, at: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], colour: Colour, unit: float
) -> None:
    if math.hypot(*b) > 2 * unit:
        phase = np.linspace(0, 2 * np.pi, 73)
        path = at + np.outer(np.sin(phase), a) + np.outer(np.cos(phase), b)
        for width, ink in ((_thick(unit) + 2, (0, 0, 0)), (_thick(unit), colour)):
            cv2.polylines(image, [np.rint(path).astype(np.int32)], True, ink, width, cv2.LINE_AA)
    tip = min(0.3, 9 * unit / max(math.hypot(*a), 1e-9))
    for width, ink in ((_thick(unit) + 2, (0, 0, 0)), (_thick(unit), colour)):
        for end in (at + a, at - a):
            cv2.arrowedLine(image, _point(at), _point(end), ink, width, cv2.LINE_AA, 0, tip)
    cv2.circle(image, _point(at), max(2, round(2.2 * unit)), colour, -1, cv2.LINE_AA)


def _point(at: NDArray[np.float64]) -> tuple[int, int]:
    limit = 30_000  # OpenCV takes no more
    return int(np.clip(round(float(at[0])), -limit, limit)), int(np.clip(round(float(at[1])), -limit, limit))


def _thick(unit: float) -> int:
    return max(1, round(1.4 * unit))


def _write(image: Image, text: str, at: NDArray[np.float64], size: float, colour: Colour = (255, 255, 255)) -> int:
    """Write on a darkened patch of the image; return the width taken, px."""
    size = max(size, 0.35)
    (width, height), below = cv2.getTextSize(text, _FONT, size, 1)
    x, y = _point(at)
    patch = image[max(y - height - 2, 0) : max(y + below, 0), max(x - 2, 0) : max(x + width + 2, 0)]
    patch //= 3
    cv2.putText(image, text, (x, y), _FONT, size, colour, 1, cv2.LINE_AA)
    return int(width)


def _caption(image: Image, title: str, rows: Sequence[Row], unit: float, *, has_mm: bool) -> None:
    """Title, and what the colours mean with how many there are of each, on a band of their own along the top."""
    band = round(46 * unit)
    image[:band] = image[:band] // 4
    amplitude = "semi-amplitude in mm" if has_mm else "semi-amplitude in px"
    _write(image, f"{title}   vectors x {MAGNIFICATION:.0f}, {amplitude}", np.array([10, 18]) * unit, 0.55 * unit)
    counts = Counter(_kind(row) for row in rows)
    x = 10.0 * unit
    for kind, colour in COLOURS.items():
        if counts[kind]:
            x += _write(image, f"{counts[kind]} {kind}", np.array([x, 38 * unit]), 0.5 * unit, colour) + 24 * unit
