"""The page of a data-set folder, from its results and capture files."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2

from labdaemon.errors import ConfigError, DataError
from labdaemon.processing import (
    NOT_FRAMES,
    RESULTS,
    CaptureFacts,
    Row,
    capture_facts,
    check_captures,
    open_folder,
    read_csv,
)
from labdaemon.report.accuracy import CaptureAccuracy, compare
from labdaemon.report.flagged_patches import flagged_patches
from labdaemon.report.gauge_comparison import read_gauges
from labdaemon.report.html import CaptureSection, PageImage, PageSupplement, write_page
from labdaemon.report.overlay import overlay_path
from labdaemon.report.provenance import provenance
from labdaemon.report.resonance_section import resonance_section
from labdaemon.report.setup_figure import setup_svg
from labdaemon.report.state_comparison import State, state_section
from labdaemon.tomlfile import read_toml

IMAGE_WIDTH_PX = 760
"""Of overlays in the page; the large ones lie next to it."""
MAX_ILLUSTRATED = 40
"""A campaign of more captures than this gets a page without overlays, which stays below some 10 MB."""

Truth = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows of truth by capture, as `labdaemon.report.accuracy.compare` takes them."""


def envelopes(results: Path) -> dict[str, list[Row]]:
    """Rows of `envelope.csv` by capture, in the order of the file.

    Raises
    ------
    DataError
        There are no results.
    """
    path = results / "envelope.csv"
    if not os.path.isfile(path):
        raise DataError("is not there; run `labdaemon process` on the folder first", file=path)
    captures: dict[str, list[Row]] = {}
    for row in read_csv(path):
        captures.setdefault(str(row["capture"]), []).append(row)
    return captures


def report_folder(
    folder: Path,
    *,
    title: str,
    subtitle: str = "",
    truth: Truth | None = None,
    results: Path | None = None,
    baseline: Path | None = None,
) -> tuple[Path, list[CaptureAccuracy]]:
    """Write the page of a data-set folder.

    Parameters
    ----------
    folder
        The data-set folder.
    title, subtitle
        Plain text.
    truth
        What really happened, by capture or group; None where it is unknown.
    results
        Where the result files are; FOLDER/results by default.
    baseline
        Data-set folder of an earlier state, to compare with.

    Returns
    -------
    page : Path
        ``index.html`` in the results.
    accuracy : list of CaptureAccuracy
        One for each capture whose truth is known.

    Raises
    ------
    DataError
        There are no results, nothing can be compared with the baseline, or the page cannot be written.
    """
    if not os.path.isdir(folder):
        raise DataError("is not a folder", file=folder)
    results = results or folder / "results"
    known = capture_facts(folder)
    facts = _facts(folder)
    cameras = sorted({path.stem for path in folder.glob("captures/*/*") if path.suffix not in NOT_FRAMES})
    measured = envelopes(results)
    check_captures(folder, measured, known)
    if len(measured) > MAX_ILLUSTRATED:
        cameras = []
    shown = [
        CaptureSection(
            name,
            rows,
            facts.get(name, {}),
            _overlays(results, name, cameras),
            compare(name, rows, truth[name]) if truth and name in truth else None,
            about.frequency_hz,
            about.excitation_amplitude_mm,
            about.is_phase_known,
        )
        for name, rows in measured.items()
        for about in [known.get(name, CaptureFacts())]
    ]
    gauges = read_gauges(results / "gauges.csv", measured, _stands_for(folder))
    page = results / "index.html"
    heading = "; ".join(part for part in (subtitle, _line_note(folder)) if part)
    pixels = results / "measurements.csv"
    flagged = flagged_patches(folder, read_csv(pixels) if pixels.is_file() else [], measured, known)
    change = None
    if baseline is not None:
        before = State(envelopes(baseline / RESULTS), capture_facts(baseline))
        change = state_section(folder, baseline, (before, State(measured, known)))
    is_excited = any(capture.frequency_hz is not None for capture in shown)
    resonances = resonance_section(folder, results) if is_excited else None
    write_page(
        page,
        title,
        heading,
        shown,
        PageSupplement(gauges, provenance(folder), resonances, flagged, change, _setup(folder, measured)),
    )
    return page, [one.accuracy for one in shown if one.accuracy is not None]


def _line_note(folder: Path) -> str:
    """What the rig file accepted instead of an enable line that was seen to stop the table; empty where nothing."""
    try:
        interlocks = read_toml(folder / "rig.toml")[1].get("interlocks")
    except ConfigError:  # a folder of other origin has no rig file to state it
        return ""
    is_accepted = isinstance(interlocks, dict) and interlocks.get("accept_no_enable") is True
    return "taken with accept_no_enable: the table needed no proven enable line" if is_accepted else ""


def _setup(folder: Path, measured: Mapping[str, Sequence[Row]]) -> str | None:
    """Figure of the set-up; None where the survey cannot be read, as the page needs none."""
    try:
        control = open_folder(folder).control
    except (ConfigError, DataError):
        return None
    rows = [row for of_capture in measured.values() for row in of_capture if isinstance(row["x_mm"], float)]
    places = {str(row["target"]): [float(str(row[f"{axis}_mm"])) for axis in "xyz"] for row in rows}
    return setup_svg(places, {point.name: (point.x_mm, point.y_mm, point.z_mm) for point in control})


def _stands_for(folder: Path) -> dict[str, tuple[str, ...]]:
    """Patterns of targets by gauge; empty where the rig file cannot be read, as the page needs none."""
    try:
        return open_folder(folder).rig.stands_for
    except (ConfigError, DataError):
        return {}


def _facts(folder: Path) -> dict[str, dict[str, str]]:
    """What the capture files say, by capture and by group."""
    facts: dict[str, dict[str, str]] = {}
    for path in sorted(folder.glob("captures/*/capture.toml")):
        _, about = read_toml(path)
        label, capture = str(about.get("label") or ""), path.parent.name
        # The name of a planned capture is its step's label and a number: nothing new.
        stated = {"label": label} if label and not capture.startswith(label) else {}
        if "frequency_hz" in about:
            stated["excitation"] = f"{about['frequency_hz']:g} Hz"
        if "excitation_amplitude_mm" in about:
            stated["table"] = f"{about['excitation_amplitude_mm']:g} mm"
        if "exposure_s" in about:
            stated["exposure"] = f"{about['exposure_s']:.4g} s"
        if "opened_at" in about:
            stated["opened"] = str(about["opened_at"])
        facts[path.parent.name] = stated
        if about.get("group"):
            facts[str(about["group"])] = stated
    return facts


def _overlays(results: Path, name: str, cameras: Sequence[str]) -> list[PageImage]:
    """Overlays of a capture that are there, a camera each."""
    images = []
    for camera in cameras:
        path = overlay_path(results, name, camera)
        image = cv2.imread(str(path)) if path.is_file() else None
        if image is not None:
            height, width = image.shape[:2]
            size = (IMAGE_WIDTH_PX, round(height * IMAGE_WIDTH_PX / width))
            small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 82])
            uri = f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
            images.append(
                PageImage(f"{camera}: the vectors on the photograph", uri, path.relative_to(results).as_posix())
            )
    return images
