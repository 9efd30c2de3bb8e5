"""Amplitude over frequency, one line per target, as SVG; per millimetre of the table where its amplitude is known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from labdaemon.report.figures import axis_ticks, colour, svg_text

MAX_LINES = 12
"""More lines are not readable; those with the largest amplitudes are drawn."""
WIDTH, HEIGHT = 760.0, 300.0


@dataclass(frozen=True, slots=True)
class ChartPoint:
    """Amplitude of a target at a frequency, and its standard deviation; mm, or mm per mm of the table."""

    frequency_hz: float
    amplitude: float
    sd: float


def frequency_svg(targets: Mapping[str, Sequence[ChartPoint]], *, is_ratio: bool) -> str | None:
    """An ``<svg>`` element, or None where no target was measured at two frequencies.

    Parameters
    ----------
    targets
        Points of each target, in any order.
    is_ratio
        Whether amplitudes are per amplitude of the table.
    """
    lines = {
        name: sorted(points, key=lambda point: point.frequency_hz)
        for name, points in targets.items()
        if len({point.frequency_hz for point in points}) > 1
    }
    if not lines:
        return None
    peak = {name: max(point.amplitude for point in points) for name, points in lines.items()}
    drawn = sorted(lines, key=lambda name: -peak[name])[:MAX_LINES]
    points = [point for name in drawn for point in lines[name]]
    low, high = min(p.frequency_hz for p in points), max(p.frequency_hz for p in points)
    most = max(p.amplitude + (p.sd if math.isfinite(p.sd) else 0.0) for p in points) * 1.05 or 1.0
    left, right, top, bottom = 60.0, WIDTH - 150.0, 14.0, HEIGHT - 40.0

    def across(value: float) -> float:
        return left + (right - left) * (value - low) / (high - low)

    def down(value: float) -> float:
        return bottom - (bottom - top) * value / most

    parts = []
    for value in axis_ticks(0.0, most, 5):
        y = down(value)
        parts.append(f'<line x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="var(--grid)"/>')
        parts.append(svg_text(left - 6, y + 3.5, f"{value:g}", "end"))
    parts += [svg_text(across(value), bottom + 16, f"{value:g}", "middle") for value in axis_ticks(low, high, 8)]
    parts.append(svg_text((left + right) / 2, bottom + 33, "frequency Hz", "middle"))
    label = "amplitude per amplitude of the table" if is_ratio else "amplitude mm"
    parts.append(svg_text(14, (top + bottom) / 2, label, "middle", turn=True))
    for place, name in enumerate(drawn):
        tint = colour(1.0 - place / max(len(drawn) - 1, 1))
        path = " ".join(f"{across(p.frequency_hz):.1f},{down(p.amplitude):.1f}" for p in lines[name])
        bars = "".join(
            f'<path d="M{across(p.frequency_hz):.1f} {down(max(p.amplitude - p.sd, 0)):.1f}'
            f'V{down(p.amplitude + p.sd):.1f}"/>'
            for p in lines[name]
            if math.isfinite(p.sd)
        )
        parts.append(
            f'<g stroke="{tint}" fill="none"><title>{escape(name)}</title>'
            f'<polyline points="{path}" stroke-width="1.8"/>{bars}</g>'
        )
        y = top + 12 + 17 * place
        parts.append(f'<path d="M{right + 12} {y - 4}h14" stroke="{tint}" stroke-width="2.5"/>')
        parts.append(svg_text(right + 31, y, name, "start"))
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" role="img" '
        f'aria-label="Amplitude over frequency">{"".join(parts)}</svg>'
    )
