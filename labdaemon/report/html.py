"""One static page about a data-set folder's results: nothing in it is fetched from anywhere.

It shows each capture's envelope magnified, every target with its standard deviation and flags, and, where the truth is
known (simulated rigs), how far the results are from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from labdaemon.durable import write_durably
from labdaemon.orbit_size import largest_motion
from labdaemon.report.accuracy import FLOOR_MM, CaptureAccuracy, row_axes, semi_amplitude_sd_mm, summary
from labdaemon.report.figures import MAGNIFY, envelope_svg, errors_svg


@dataclass(frozen=True, slots=True)
class PageImage:
    """An image in the page.

    Attributes
    ----------
    name
        Its caption.
    data_uri
        The image itself, small.
    link
        Path of the large one relative to the page.
    """

    name: str
    data_uri: str
    link: str


@dataclass(frozen=True, slots=True)
class CaptureSection:
    """What the page shows of one capture.

    Attributes
    ----------
    name
        The capture's (or group's).
    rows
        Its rows of `envelope.csv`.
    about
        Facts for its heading by name, as ``{"excitation": "5 Hz, 2 mm"}``.
    overlays
        Overlays of the frames, if there are any.
    accuracy
        Against the truth, if it is known.
    """

    name: str
    rows: Sequence[Mapping[str, Any]]
    about: Mapping[str, str] = field(default_factory=dict)
    overlays: Sequence[PageImage] = ()
    accuracy: CaptureAccuracy | None = None


def write_page(path: Path, title: str, subtitle: str, captures: Sequence[CaptureSection]) -> None:
    """Write the page whole or not at all.

    Raises
    ------
    StorageError
        The folder cannot be written.
    """
    write_durably(path, page(title, subtitle, captures))


@dataclass(frozen=True, slots=True)
class _Grid:
    """A table: its head, its lines, and whether the last column holds flags."""

    head: Sequence[str]
    lines: Sequence[Sequence[str]]
    flags: bool = False


def page(title: str, subtitle: str, captures: Sequence[CaptureSection]) -> str:
    """The page's text, from the template ``templates/page.html``.

    Parameters
    ----------
    title, subtitle
        Plain text.
    captures
        In the order they are shown.
    """
    compared = [capture.accuracy for capture in captures if capture.accuracy is not None]
    return (
        _environment()
        .get_template("page.html")
        .render(
            title=title,
            subtitle=subtitle,
            style=_environment().get_template("page.css").render(),
            facts=_overview(captures),
            accuracy=_accuracy(compared) if compared else None,
            magnify=f"{MAGNIFY:g}",
            captures=[_capture(capture) for capture in captures],
        )
    )


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("labdaemon.report"),
        autoescape=select_autoescape(["html"]),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )


def _overview(captures: Sequence[CaptureSection]) -> list[tuple[str, str]]:
    """Numbers of the whole page, each with its label."""
    measured = [row for capture in captures for row in capture.rows if row_axes(row) is not None]
    clean = sum(not set(row.get("flags") or ()) - {"at_rest"} for row in measured)
    total = sum(len(capture.rows) for capture in captures)
    facts = [(str(len(captures)), "captures"), (f"{len(measured)} of {total}", "targets measured")]
    if total:
        facts.append((f"{clean / total:.1%}", "without a warning"))
    motion = largest_motion(measured)
    doubt = f"; {motion.doubtful} doubtful" if motion.doubtful else ""
    if motion.size_mm is not None:
        facts.append((f"{motion.size_mm:.3f} mm", f"largest semi-amplitude, at {motion.target}{doubt}"))
    elif motion.doubtful_mm is not None:
        facts.append((f"{motion.doubtful_mm:.3f} mm?", f"largest, at {motion.doubtful_target}, but all are doubtful"))
    return facts


def _accuracy(compared: Sequence[CaptureAccuracy]) -> dict[str, Any]:
    """Table and figure of the errors against the truth."""
    pooled = summary("all", [pair for one in compared for pair in one.pairs])
    head = ("capture", "targets", "unflagged", "compared", "mean error mm", "sd mm", "95 % within mm")
    lines = [
        (
            one.capture,
            str(one.targets),
            str(one.unflagged),
            str(one.compared),
            _number(one.mean_mm, "+.4f"),
            _number(one.sd_mm, ".4f"),
            _number(one.p95_mm, ".4f"),
        )
        for one in [*compared, pooled]
    ]
    figure = errors_svg({one.capture: one.pairs for one in compared})
    return {"floor_mm": f"{FLOOR_MM:g}", "grid": _Grid(head, lines), "figure": figure}


def _capture(capture: CaptureSection) -> dict[str, Any]:
    """What the template shows of one capture."""
    head = ("target", "x mm", "y mm", "z mm", "amplitude mm", "sd mm", "direction x", "y", "z", "minor mm", "flags")
    return {
        "name": capture.name,
        "about": capture.about,
        "figure": envelope_svg(capture.rows),
        "overlays": capture.overlays,
        "grid": _Grid(head, [_row(row) for row in capture.rows], flags=True),
    }


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    axes = row_axes(row)
    flags = ", ".join(row.get("flags") or ())
    place = tuple(_number(row.get(name), ".2f") for name in ("x_mm", "y_mm", "z_mm"))
    if axes is None:
        return (str(row["target"]), *place, "", "", "", "", "", "", flags)
    major, minor = (math.sqrt(float(axis @ axis)) for axis in axes)
    direction = tuple(f"{part / major:+.3f}" if major > 0 else "" for part in axes[0])
    sd = _number(semi_amplitude_sd_mm(row), ".4f")
    return (str(row["target"]), *place, f"{major:.4f}", sd, *direction, f"{minor:.4f}", flags)


def _number(value: float | None, form: str) -> str:
    return "–" if value is None or math.isnan(value) else format(value, form)
