"""One static page about a data-set folder's results: nothing in it is fetched from anywhere.

It shows each capture's envelope magnified, every target with its standard deviation and flags, and, where the truth is
known (simulated rigs), how far the results are from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from labdaemon.durable import write_durably
from labdaemon.orbit_size import largest_motion
from labdaemon.report.accuracy import FLOOR_MM, CaptureAccuracy, row_axes, semi_amplitude_sd_mm, summary
from labdaemon.report.figures import MAGNIFY, envelope_svg, errors_svg

_STYLE = """
:root{--paper:#fff;--ink:#1d2129;--faint:#7b8494;--grid:#e4e7ec;--band:#f6f7f9;--good:#18794e;--bad:#c13515;
color-scheme:light dark}
@media(prefers-color-scheme:dark){:root{--paper:#15181d;--ink:#e6e9ee;--faint:#8d97a7;--grid:#2c323b;--band:#1c2026;
--good:#4cc38a;--bad:#ff8b6a}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2.5rem 1.5rem 4rem;max-width:68rem;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
h1{font-size:1.7rem;margin:0 0 .2rem;letter-spacing:-.01em}
h2{font-size:1.2rem;margin:2.8rem 0 .4rem;padding-top:1rem;border-top:1px solid var(--grid)}
p{margin:.3rem 0 1rem;max-width:46rem}.sub{color:var(--faint)}
figure{margin:1rem 0;overflow-x:auto}svg{max-width:100%;height:auto;display:block}
figcaption{color:var(--faint);font-size:.86rem;margin-top:.4rem;max-width:46rem}
svg text{font:11px system-ui,-apple-system,"Segoe UI",Roboto,sans-serif;fill:var(--faint)}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.88rem;margin:.6rem 0}
.wide{overflow-x:auto}th{font-weight:600;color:var(--faint);text-align:right;border-bottom:1px solid var(--grid)}
th,td{padding:.22rem .7rem;white-space:nowrap}td{text-align:right}
th:first-child,td:first-child,td.flags,th.flags{text-align:left}
tbody tr:nth-child(even){background:var(--band)}td.flags{color:var(--bad)}
details summary{cursor:pointer;color:var(--faint);margin:.5rem 0}
.images{display:grid;grid-template-columns:repeat(auto-fit,minmax(20rem,1fr));gap:0 1.2rem}
.images img{display:block;width:100%;border-radius:3px}
.numbers{display:flex;flex-wrap:wrap;gap:1rem 2.6rem;margin:1.4rem 0}
.numbers div{line-height:1.25}.numbers b{display:block;font-size:1.5rem;font-weight:600}
.numbers span{color:var(--faint)}
@media print{body{max-width:none;padding:0}details{display:block}h2{break-after:avoid}figure{break-inside:avoid}}
"""


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


def page(title: str, subtitle: str, captures: Sequence[CaptureSection]) -> str:
    """The page's text.

    Parameters
    ----------
    title, subtitle
        Plain text.
    captures
        In the order they are shown.
    """
    body = [f"<h1>{escape(title)}</h1>", f'<p class="sub">{escape(subtitle)}</p>', _overview(captures)]
    known = [capture for capture in captures if capture.accuracy is not None]
    if known:
        body.append(_accuracy([capture.accuracy for capture in known if capture.accuracy is not None]))
    body += [_capture(capture) for capture in captures]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n{chr(10).join(body)}\n</body></html>\n"
    )


def _overview(captures: Sequence[CaptureSection]) -> str:
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
    cells = "".join(f"<div><b>{escape(value)}</b><span>{escape(label)}</span></div>" for value, label in facts)
    return f'<div class="numbers">{cells}</div>'


def _accuracy(compared: Sequence[CaptureAccuracy]) -> str:
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
    return (
        "<h2>Accuracy against the simulator’s truth</h2>"
        f"<p>Error of the semi-amplitude, measured minus true, of unflagged targets that moved {FLOOR_MM:g} mm or "
        "more. "
        "The truth is the simulated structure’s own motion while the shutters were open; the measurement never sees "
        "it.</p>"
        f"{_table(head, lines)}"
        f"<figure>{errors_svg({one.capture: one.pairs for one in compared})}"
        "<figcaption>Each dot is a target; its bar is one standard deviation as reported.</figcaption></figure>"
    )


def _capture(capture: CaptureSection) -> str:
    facts = " · ".join(f"{escape(name)} {escape(value)}" for name, value in capture.about.items())
    head = ("target", "x mm", "y mm", "z mm", "amplitude mm", "sd mm", "direction x", "y", "z", "minor mm", "flags")
    shown = "".join(
        f'<figure><a href="{escape(image.link)}"><img src="{escape(image.data_uri)}" alt="{escape(image.name)}">'
        f"</a><figcaption>{escape(image.name)}</figcaption></figure>"
        for image in capture.overlays
    )
    images = f'<div class="images">{shown}</div>' if shown else ""
    return (
        f'<h2>{escape(capture.name)}</h2><p class="sub">{facts}</p>'
        f"<figure>{envelope_svg(capture.rows)}<figcaption>Paths of the targets, magnified {MAGNIFY:g} times about "
        "their mean positions. Dashed: flagged. Hover for names and numbers.</figcaption></figure>"
        f"{images}<details><summary>{len(capture.rows)} targets in numbers</summary>"
        f'<div class="wide">{_table(head, [_row(row) for row in capture.rows], flags=True)}</div></details>'
    )


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


def _table(head: Sequence[str], lines: Sequence[Sequence[str]], *, flags: bool = False) -> str:
    last = len(head) - 1 if flags else -1
    top = "".join(f"<th{_kind(place == last)}>{escape(cell)}</th>" for place, cell in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f"<td{_kind(place == last)}>{escape(cell)}</td>" for place, cell in enumerate(line)) + "</tr>"
        for line in lines
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _kind(is_flags: bool) -> str:
    return ' class="flags"' if is_flags else ""


def _number(value: float | None, form: str) -> str:
    return "–" if value is None or math.isnan(value) else format(value, form)
