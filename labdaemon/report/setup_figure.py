"""The set-up from the front and from above: where the targets are, and the control targets that hold the axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from labdaemon.report.figures import FLAT_SHARE, FigureView, FloatArray, svg_text
from labdaemon.report.palette import LINE_COLOURS

HEIGHT = 360.0
LARGEST_WIDTH = 460.0
"""Of one view; a set-up that is wide and low is drawn smaller."""
MAX_NAMES = 40
"""Control targets up to which each has its name."""

Places = Mapping[str, Sequence[float]]


def setup_svg(targets: Places, control: Places) -> str | None:
    """An ``<svg>`` element; None without control targets.

    Parameters
    ----------
    targets, control
        x, y and z of each, mm, by name.
    """
    if not control:
        return None
    seen, held = (np.array([*places.values()], dtype=float).reshape(-1, 3) for places in (targets, control))
    every = np.concatenate([seen, held])
    spans = np.ptp(every, axis=0)
    room = max(0.06 * float(spans.max()), 1.0)
    low, high = every.min(axis=0) - room, every.max(axis=0) + room
    spans = high - low
    views = [(0, 2)] + ([(0, 1)] if spans[1] - 2 * room > FLAT_SHARE * spans[0] else [])
    margin, left = 46.0, 60.0
    scale = min((HEIGHT - 2 * margin) / float(spans[2]), LARGEST_WIDTH / float(spans[0]))
    parts, bottom = [], 0.0
    for axis, up in views:
        view = FigureView(axis, up, left, margin, scale, low, high)
        parts += view.frame()
        parts += _marks(view, targets, seen, _DOT)
        parts += _marks(view, control, held, _TRIANGLE, has_names=len(control) <= MAX_NAMES)
        left, bottom = view.right + 62.0, max(bottom, view.bottom)
    for place, (look, text) in enumerate(
        ((_DOT, f"targets ({len(targets)})"), (_TRIANGLE, f"control targets ({len(control)})"))
    ):
        y = margin + 8 + 20 * place
        parts.append(f'<path d="M{left - 36:.1f} {y - 4:.1f}{look}/>')
        parts.append(svg_text(left - 24, y, text, "start"))
    width, tall = left + 90, bottom + margin
    return (
        f'<svg viewBox="0 0 {width:.0f} {tall:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="Targets and control targets from the front and from above">{"".join(parts)}</svg>'
    )


_DOT = f'm-2.4 0a2.4 2.4 0 1 0 4.8 0a2.4 2.4 0 1 0 -4.8 0z" fill="{LINE_COLOURS[0]}"'
_TRIANGLE = f'm0 -5l5 8.6h-10z" fill="none" stroke="{LINE_COLOURS[1]}" stroke-width="1.6"'
"""Rest of a path's data and its attributes; triangles are control targets, as in Fig. 11 of McCarthy (2016)."""


def _marks(view: FigureView, names: Places, places: FloatArray, look: str, *, has_names: bool = False) -> list[str]:
    parts = []
    for name, (x, y) in zip(names, view.place(places), strict=True):
        parts.append(f'<path d="M{x:.1f} {y:.1f}{look}><title>{escape(name)}</title></path>')
        if has_names:
            parts.append(svg_text(float(x), float(y) - 8, name, "middle"))
    return parts
