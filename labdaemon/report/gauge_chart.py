"""Image minus gauge over the amplitude, as SVG: Fig. 13 of McCarthy, Chandler and Palmeri (2016)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from labdaemon.report.figures import axis_ticks, svg_text
from labdaemon.report.gauge_comparison import GaugeComparison, GaugeSummary, summarise
from labdaemon.report.palette import line_colour, line_style

WIDTH, HEIGHT = 760.0, 280.0
LEFT, RIGHT, TOP, BOTTOM = 70.0, WIDTH - 130.0, 14.0, HEIGHT - 40.0


def gauge_svg(readings: Sequence[GaugeComparison]) -> str | None:
    """A point a capture with a bar of one sd of the difference, and for each gauge the mean and what 95 % keep.

    None where no gauge stands for a measured target.
    """
    seen = [one for one in readings if one.difference_mm is not None]
    if not seen:
        return None
    most = max(one.amplitude_mm or 0.0 for one in seen) * 1.05 or 1.0
    reach = max(abs(one.difference_mm or 0.0) + _sd_mm(one) for one in seen) * 1.1 or 1e-3
    summaries = summarise(seen)
    index = {one.gauge: number for number, one in enumerate(summaries)}

    def across(amplitude_mm: float) -> float:
        return LEFT + (RIGHT - LEFT) * amplitude_mm / most

    def down(difference_mm: float) -> float:
        return (TOP + BOTTOM) / 2 - (BOTTOM - TOP) / 2 * difference_mm / reach

    parts = []
    for value in axis_ticks(-reach, reach, 5):
        look = f'stroke="var({"--faint" if value == 0 else "--grid"})"'
        parts.append(f'<line x1="{LEFT}" x2="{RIGHT}" y1="{down(value):.1f}" y2="{down(value):.1f}" {look}/>')
        parts.append(svg_text(LEFT - 6, down(value) + 3.5, f"{value:g}", "end"))
    parts += [svg_text(across(value), BOTTOM + 16, f"{value:g}", "middle") for value in axis_ticks(0.0, most, 8)]
    parts.append(svg_text((LEFT + RIGHT) / 2, BOTTOM + 33, "amplitude by the gauge mm", "middle"))
    parts.append(svg_text(14, (TOP + BOTTOM) / 2, "image minus gauge mm", "middle", turn=True))
    for one in summaries:
        parts.append(_band(one, index[one.gauge], down(one.mean_mm), down(one.p95_mm), down(-one.p95_mm)))
    for reading in seen:
        x, difference, sd = across(reading.amplitude_mm or 0.0), reading.difference_mm or 0.0, _sd_mm(reading)
        title = escape(f"{reading.capture}, {reading.gauge}: {difference:+.4f} mm, sd {sd:.4f} mm")
        parts.append(
            f'<g stroke="{line_colour(index[reading.gauge])}" fill="var(--paper)"><title>{title}</title>'
            f'<path d="M{x:.1f} {down(difference - sd):.1f}V{down(difference + sd):.1f}"/>'
            f'<circle cx="{x:.1f}" cy="{down(difference):.1f}" r="3"/></g>'
        )
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" role="img" '
        f'aria-label="Image minus gauge over amplitude">{"".join(parts)}</svg>'
    )


def _band(one: GaugeSummary, index: int, mean: float, top: float, bottom: float) -> str:
    """The mean as a line, the range of 95 % of the differences as a band."""
    y = TOP + 12 + 34 * index
    return (
        f'<rect x="{LEFT}" width="{RIGHT - LEFT}" y="{top:.1f}" height="{max(bottom - top, 0.5):.1f}" '
        f'fill="{line_colour(index)}" fill-opacity="0.1"/>'
        f'<path d="M{LEFT} {mean:.1f}H{RIGHT}" fill="none" {line_style(index)} stroke-width="1.6"/>'
        f'<path d="M{RIGHT + 12} {y - 4}h14" fill="none" {line_style(index)} stroke-width="2"/>'
        f"{svg_text(RIGHT + 31, y, one.gauge, 'start')}"
        f"{svg_text(RIGHT + 31, y + 14, f'95 %: {one.p95_mm:.3g} mm', 'start')}"
    )


def _sd_mm(one: GaugeComparison) -> float:
    """Standard deviation of the difference; parts that are not known count as 0."""
    return math.hypot(one.sd_mm or 0.0, one.image_sd_mm or 0.0)
