"""Amplitude over frequency as SVG: measured points with their sd, and the fitted resonance curves where there are any.

Per millimetre of the table where its amplitude is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from labdaemon.report.figures import axis_ticks, svg_text
from labdaemon.report.palette import line_colour, line_style

MAX_LINES = 6
"""More lines are not readable; those with the largest amplitudes are drawn."""
WIDTH, HEIGHT = 760.0, 320.0
LEFT, RIGHT, TOP, BOTTOM = 60.0, WIDTH - 96.0, 14.0, HEIGHT - 40.0
LOGARITHMIC_RATIO = 30.0
"""Ratio of the largest to the smallest amplitude from which the axis is logarithmic."""
_LABEL_STEP = 14.0
_FORMS = (
    "m-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0z",
    "m-2.7 -2.7h5.4v5.4h-5.4z",
    "m0 -3.6l3.4 6h-6.8z",
    "m0 -3.8l3.8 3.8l-3.8 3.8l-3.8 -3.8z",
    "m0 3.6l3.4 -6h-6.8z",
    "m-3 -3l6 6m0 -6l-6 6",
)
"""Outlines of points, as path data from their middle."""

Curve = Sequence[tuple[float, float]]
"""(frequency in Hz, amplitude in the unit of the points), ascending."""


@dataclass(frozen=True, slots=True)
class ChartPoint:
    """Amplitude of a target at a frequency, and its standard deviation; mm, or mm per mm of the table."""

    frequency_hz: float
    amplitude: float
    sd: float


@dataclass(frozen=True, slots=True)
class _Scale:
    """Places of frequencies and amplitudes in the drawing."""

    low_hz: float
    high_hz: float
    least: float
    most: float

    @property
    def is_log(self) -> bool:
        """Whether amplitudes are on a logarithmic axis."""
        return self.least > 0

    def across(self, frequency_hz: float) -> float:
        return LEFT + (RIGHT - LEFT) * (frequency_hz - self.low_hz) / (self.high_hz - self.low_hz)

    def down(self, amplitude: float) -> float:
        if not self.is_log:
            return BOTTOM - (BOTTOM - TOP) * min(max(amplitude / self.most, 0.0), 1.0)
        place = math.log(max(amplitude, self.least) / self.least) / math.log(self.most / self.least)
        return BOTTOM - (BOTTOM - TOP) * min(place, 1.0)

    def ticks(self) -> list[float]:
        if not self.is_log:
            return axis_ticks(0.0, self.most, 5)
        powers = range(math.floor(math.log10(self.least)), math.ceil(math.log10(self.most)) + 1)
        values = [digit * 10.0**power for power in powers for digit in (1, 2, 5)]
        return [value for value in values if self.least <= value <= self.most]


def frequency_svg(
    targets: Mapping[str, Sequence[ChartPoint]], *, is_ratio: bool, curves: Mapping[str, Curve] | None = None
) -> str | None:
    """An ``<svg>`` element, or None where no target was measured at two frequencies.

    Parameters
    ----------
    targets
        Points of each target, in any order.
    is_ratio
        Whether amplitudes are per amplitude of the table.
    curves
        The fitted model by target. Without one, thin lines only guide the eye from point to point.
    """
    fitted = curves or {}
    lines = {
        name: sorted(points, key=lambda point: point.frequency_hz)
        for name, points in targets.items()
        if len({point.frequency_hz for point in points}) > 1
    }
    if not lines:
        return None
    peak = {name: max(point.amplitude for point in points) for name, points in lines.items()}
    drawn = sorted(fitted.keys() & lines.keys() or lines, key=lambda name: (-peak[name], name))[:MAX_LINES]
    scale = _scale([lines[name] for name in drawn], [fitted[name] for name in drawn if name in fitted])
    label = "amplitude per amplitude of the table" if is_ratio else "amplitude mm"
    parts = _axes(scale, label)
    for index, name in enumerate(drawn):
        parts.append(_line(index, name, lines[name], fitted.get(name), scale))
    parts += _labels({name: scale.down(_last(lines[name], fitted.get(name))) for name in drawn})
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" role="img" '
        f'aria-label="Amplitude over frequency">{"".join(parts)}</svg>'
    )


def _scale(lines: Sequence[Sequence[ChartPoint]], curves: Sequence[Curve]) -> _Scale:
    points = [point for line in lines for point in line]
    values = [point.amplitude for point in points] + [value for curve in curves for _, value in curve]
    most = max([*values, *(p.amplitude + p.sd for p in points if math.isfinite(p.sd))]) * 1.05 or 1.0
    least = min((point.amplitude for point in points if point.amplitude > 0), default=most)
    is_log = most > LOGARITHMIC_RATIO * least
    low, high = min(p.frequency_hz for p in points), max(p.frequency_hz for p in points)
    return _Scale(low, high, max(least / 1.3, 1e-4 * most) if is_log else 0.0, most)


def _axes(scale: _Scale, label: str) -> list[str]:
    parts = []
    for value in scale.ticks():
        y = scale.down(value)
        parts.append(f'<line x1="{LEFT}" x2="{RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="var(--grid)"/>')
        parts.append(svg_text(LEFT - 6, y + 3.5, f"{value:g}", "end"))
    for value in axis_ticks(scale.low_hz, scale.high_hz, 8):
        parts.append(svg_text(scale.across(value), BOTTOM + 16, f"{value:g}", "middle"))
    parts.append(svg_text((LEFT + RIGHT) / 2, BOTTOM + 33, "frequency Hz", "middle"))
    parts.append(svg_text(14, (TOP + BOTTOM) / 2, label, "middle", turn=True))
    return parts


def _line(index: int, name: str, points: Sequence[ChartPoint], curve: Curve | None, scale: _Scale) -> str:
    """A target: its curve, or a faint guide to the eye, and its points with bars of one sd."""
    course = curve or [(point.frequency_hz, point.amplitude) for point in points]
    path = " ".join(f"{scale.across(frequency):.1f},{scale.down(value):.1f}" for frequency, value in course)
    look = 'stroke-width="1.8"' if curve else 'stroke-width="1" stroke-opacity="0.45"'
    marks = "".join(
        _bar(point, scale)
        + _mark(index, scale.across(point.frequency_hz), scale.down(point.amplitude), f"{name}: {point.amplitude:.4g}")
        for point in points
    )
    return (
        f'<polyline points="{path}" fill="none" {line_style(index)} {look}><title>{escape(name)}</title></polyline>'
        f'<g stroke="{line_colour(index)}" fill="var(--paper)">{marks}</g>'
    )


def _bar(point: ChartPoint, scale: _Scale) -> str:
    top, bottom = (scale.down(point.amplitude + sign * point.sd) for sign in (1, -1))
    if not (math.isfinite(point.sd) and bottom - top > 2.0):
        return ""
    return f'<path d="M{scale.across(point.frequency_hz):.1f} {top:.1f}V{bottom:.1f}"/>'


def _mark(index: int, x: float, y: float, title: str) -> str:
    """A point; its form differs from line to line, as its colour does."""
    return f'<path d="M{x:.1f} {y:.1f}{_FORMS[index % len(_FORMS)]}"><title>{escape(title)}</title></path>'


def _last(points: Sequence[ChartPoint], curve: Curve | None) -> float:
    return curve[-1][1] if curve else points[-1].amplitude


def _labels(at: Mapping[str, float]) -> list[str]:
    """Names at the right ends of the lines, moved apart where they would cover each other."""
    order = sorted(at, key=lambda name: at[name])
    places: list[float] = []
    for name in order:
        places.append(max(at[name], places[-1] + _LABEL_STEP) if places else at[name])
    shift = max((places[-1] if places else 0.0) - BOTTOM, 0.0)
    places = [place - shift for place in places]
    index = {name: number for number, name in enumerate(at)}
    return [
        f'<g stroke="{line_colour(index[name])}" fill="var(--paper)">'
        f'<path d="M{RIGHT + 2} {at[name]:.1f}L{RIGHT + 12} {place:.1f}h14" fill="none"/>'
        f"{_mark(index[name], RIGHT + 26, place, name)}</g>{svg_text(RIGHT + 34, place + 3.5, name, 'start')}"
        for name, place in zip(order, places, strict=True)
    ]
