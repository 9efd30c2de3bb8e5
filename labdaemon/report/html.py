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
from labdaemon.report.figures import envelope_svg, errors_svg
from labdaemon.report.flagged_patches import FlaggedPatches
from labdaemon.report.gauge_chart import gauge_svg
from labdaemon.report.gauge_comparison import GaugeComparison
from labdaemon.report.page_tables import PageGrid, amplitude_chart, flagged_table, gauge_tables, number_text
from labdaemon.report.provenance import Provenance
from labdaemon.report.resonance_section import ResonanceSection
from labdaemon.report.space_view import SpaceCapture, space_json
from labdaemon.report.state_comparison import StateSection
from labdaemon.report.uncertainty_budget import budget

MAX_DRAWN = 24
"""Captures up to which each has its own views; the view in space shows larger campaigns, which keeps the page small."""


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
    frequency_hz, table_mm
        Excitation: frequency, and amplitude of the table; None where unknown.
    is_phase_known
        Whether a and b have the phase of the excitation.
    """

    name: str
    rows: Sequence[Mapping[str, Any]]
    about: Mapping[str, str] = field(default_factory=dict)
    overlays: Sequence[PageImage] = ()
    accuracy: CaptureAccuracy | None = None
    frequency_hz: float | None = None
    table_mm: float | None = None
    is_phase_known: bool = False


@dataclass(frozen=True, slots=True)
class PageSupplement:
    """What the page shows of all captures together, and of their origin.

    Attributes
    ----------
    gauges
        What each gauge saw, with the image results that it can be compared with.
    provenance
        None where it is not known.
    resonances
        Transmissibility, modes and the curves of their model; None where no frequency is known.
    flagged
        Drawings of flagged targets.
    change
        What changed since a baseline; None without one.
    setup
        SVG of targets and control targets; None where the survey is not known.
    """

    gauges: Sequence[GaugeComparison] = ()
    provenance: Provenance | None = None
    resonances: ResonanceSection | None = None
    flagged: FlaggedPatches = field(default_factory=FlaggedPatches)
    change: StateSection | None = None
    setup: str | None = None


def write_page(
    path: Path,
    title: str,
    subtitle: str,
    captures: Sequence[CaptureSection],
    supplement: PageSupplement | None = None,
) -> None:
    """Write the page whole or not at all.

    Raises
    ------
    StorageError
        The folder cannot be written.
    """
    write_durably(path, page(title, subtitle, captures, supplement))


def page(
    title: str, subtitle: str, captures: Sequence[CaptureSection], supplement: PageSupplement | None = None
) -> str:
    """The page's text, from the template ``templates/page.html``.

    Parameters
    ----------
    title, subtitle
        Plain text.
    captures
        In the order they are shown.
    supplement
        What is shown of all captures together; nothing if None.
    """
    more = supplement or PageSupplement()
    rows = [row for capture in captures for row in capture.rows]
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
            captures=[_capture(capture, is_drawn=len(captures) <= MAX_DRAWN) for capture in captures],
            space=_space(captures),
            script="".join(_environment().get_template(name).render() for name in ("space.js", "report.js")),
            chart=amplitude_chart(captures, more.resonances.curves if more.resonances else None),
            resonances=more.resonances,
            gauges=gauge_tables(more.gauges),
            gauge_chart=gauge_svg(more.gauges),
            budget=budget(rows),
            flagged=flagged_table(captures),
            patches=more.flagged,
            change=more.change,
            setup=more.setup,
            provenance=more.provenance,
        )
    )


def live_files() -> dict[str, str]:
    """Text of the live page's files by name: the page itself, its style and its scripts. They are the report's own."""
    names = ("live.html", "page.css", "live.css", "space.js", "live.js")
    return {name: _environment().get_template(name).render() for name in names}


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
            number_text(one.mean_mm, "+.4f"),
            number_text(one.sd_mm, ".4f"),
            number_text(one.p95_mm, ".4f"),
        )
        for one in [*compared, pooled]
    ]
    figure = errors_svg({one.capture: one.pairs for one in compared})
    return {"floor_mm": f"{FLOOR_MM:g}", "grid": PageGrid(head, lines), "figure": figure}


def _space(captures: Sequence[CaptureSection]) -> str:
    return space_json([SpaceCapture(one.name, one.rows, one.is_phase_known, one.frequency_hz) for one in captures])


def _capture(capture: CaptureSection, *, is_drawn: bool) -> dict[str, Any]:
    """What the template shows of one capture."""
    head = ("target", "x mm", "y mm", "z mm", "amplitude mm", "sd mm", "direction x", "y", "z", "minor mm", "flags")
    return {
        "name": capture.name,
        "about": capture.about,
        "figure": envelope_svg(capture.rows) if is_drawn else None,
        "overlays": capture.overlays,
        "grid": PageGrid(head, [_row(row) for row in capture.rows], flags=True),
    }


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    axes = row_axes(row)
    flags = ", ".join(row.get("flags") or ())
    place = tuple(number_text(row.get(name), ".2f") for name in ("x_mm", "y_mm", "z_mm"))
    if axes is None:
        return (str(row["target"]), *place, "", "", "", "", "", "", flags)
    major, minor = (math.sqrt(float(axis @ axis)) for axis in axes)
    direction = tuple(f"{part / major:+.3f}" if major > 0 else "" for part in axes[0])
    sd = number_text(semi_amplitude_sd_mm(row), ".4f")
    return (str(row["target"]), *place, f"{major:.4f}", sd, *direction, f"{minor:.4f}", flags)
