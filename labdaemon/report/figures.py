"""Figures as SVG text for a page: an envelope seen from the front and the side, and errors.

Colours come from the page's CSS variables (``--ink``, ``--faint``, ``--grid``), so a figure follows its page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdaemon.orbit_size import is_doubtful
from labdaemon.report.accuracy import TargetComparison, row_axes

FloatArray = NDArray[np.float64]

READABLE_SHARE = 0.1
"""Share of the structure's size that the largest motion fills when it is drawn."""
_STOPS = ((59, 111, 182), (108, 92, 201), (170, 71, 188), (222, 66, 118), (233, 84, 52))
"""Small to large amplitude; legible on white and on black."""
FLAT_SHARE = 0.05
"""Depth, as a share of the width, up to which everything counts as one plane: one view shows it all."""
_THIN_PX = 0.5
"""Semi-axis below which an ellipse would not be drawn at all."""


def colour(share: float) -> str:
    """Colour of an amplitude that is this share (0 to 1) of the largest."""
    place = min(max(share, 0.0), 1.0) * (len(_STOPS) - 1)
    low = min(int(place), len(_STOPS) - 2)
    mix = [round(a + (b - a) * (place - low)) for a, b in zip(_STOPS[low], _STOPS[low + 1], strict=True)]
    return "#{:02x}{:02x}{:02x}".format(*mix)


def magnification(places_mm: Sequence[Sequence[float]], amplitudes_mm: Sequence[float]) -> float:
    """A round factor at which the largest motion is readable: about a tenth of the structure's size.

    Parameters
    ----------
    places_mm
        (n, 3) positions.
    amplitudes_mm
        Amplitudes that count; none where all are doubtful.
    """
    size = float(np.linalg.norm(np.ptp(np.array(places_mm, dtype=float).reshape(-1, 3), axis=0)))
    largest = max(amplitudes_mm, default=0.0)
    if largest <= 0 or size <= 0:
        return 1.0
    return round_down(READABLE_SHARE * size / largest)


def envelope_svg(rows: Sequence[Mapping[str, Any]], *, height: float = 520.0) -> str:
    """One capture's envelope, motion magnified.

    Parameters
    ----------
    rows
        The capture's rows of `envelope.csv`. Rows without numbers are left out.
    height
        Of the drawing, CSS pixels.

    Returns
    -------
    str
        An ``<svg>`` element: a front view (x, z), a side view (y, z) and a plan (x, y); the front view alone where
        everything lies in one plane.
    """
    moving = [(row, found) for row in rows if (found := row_axes(row)) is not None and row.get("x_mm") is not None]
    if not moving:
        return "<p>Nothing was measured in this capture.</p>"
    centres = np.array([[row["x_mm"], row["y_mm"], row["z_mm"]] for row, _ in moving])
    lengths = [float(np.linalg.norm(major)) for _, (major, _) in moving]
    # The colour scale ends at the largest target without a doubt, or one doubtful target pales all the others.
    sure = [length for length, (row, _) in zip(lengths, moving, strict=True) if not is_doubtful(row)]
    largest = max(sure or lengths)
    magnify = magnification(centres.tolist(), sure)
    axes = magnify * np.array([pair for _, pair in moving])
    reach = np.sqrt(np.sum(axes**2, axis=1))  # of an ellipse along each coordinate
    low, high = (centres - reach).min(axis=0), (centres + reach).max(axis=0)
    room = 0.06 * float((high - low).max())  # so that a view from the side is no sliver
    low, high = low - np.array([room, room, 0.0]), high + np.array([room, room, 0.0])
    spans = np.maximum(high - low, 1.0)
    views = [(0, 2)]
    if spans[1] - 2 * room > FLAT_SHARE * spans[0]:
        views += [(1, 2), (0, 1)]
    margin, gap = 46.0, 62.0
    across, tall = (float(max(spans[view[place]] for view in views)) for place in (0, 1))
    scale = (height - 2 * margin) / max(tall, 0.35 * across)
    parts: list[str] = []
    left = margin + 14
    for axis, up in views:
        view = FigureView(axis, up, left, margin, scale, low, high)
        parts += view.frame()
        for (row, _), centre, pair, length in zip(moving, centres, axes, lengths, strict=True):
            parts.append(view.target(row, centre, pair, length, largest))
        left += float(spans[axis]) * scale + gap
    width = left - gap + 140
    parts += _legend(width - 108, margin, largest, magnify * scale)
    drawn_height = tall * scale + 2 * margin
    return (
        f'<svg viewBox="0 0 {width:.0f} {drawn_height:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="Envelope, motion magnified {magnify:g} times">{"".join(parts)}</svg>'
    )


class FigureView:
    """One orthogonal view: one axis of object space to the right, another up.

    Parameters
    ----------
    axis, up
        Index of the axis to the right, and of the one up.
    left, top
        Corner of the view in the drawing.
    scale
        Drawing units a millimetre.
    low, high
        (3,) ends of what is shown, mm.

    Attributes
    ----------
    right, bottom
        The other corner.
    """

    def __init__(
        self,
        axis: int,
        up: int,
        left: float,
        top: float,
        scale: float,
        low: NDArray[np.float64],
        high: NDArray[np.float64],
    ) -> None:
        self._axis, self._up, self._left, self._top, self._scale = axis, up, left, top, scale
        self._low, self._high = (float(low[axis]), float(low[up])), (float(high[axis]), float(high[up]))
        self.right: float = left + (self._high[0] - self._low[0]) * scale
        self.bottom: float = top + (self._high[1] - self._low[1]) * scale

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) millimetres to (n, 2) of the drawing."""
        across = self._left + (points[:, self._axis] - self._low[0]) * self._scale
        down = self.bottom - (points[:, self._up] - self._low[1]) * self._scale
        return np.stack([across, down], axis=1)

    def frame(self) -> list[str]:
        """Grid, ticks and axis names."""
        parts = [
            f'<rect x="{self._left - 8:.1f}" y="{self._top - 8:.1f}" width="{self.right - self._left + 16:.1f}" '
            f'height="{self.bottom - self._top + 16:.1f}" fill="none" stroke="var(--grid)"/>'
        ]
        for value in axis_ticks(self._low[0], self._high[0], (self.right - self._left) / 80):
            x = self._left + (value - self._low[0]) * self._scale
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{self._top - 8:.1f}" y2="{self.bottom + 8:.1f}" '
                f'stroke="var(--grid)"/>'
            )
            parts.append(svg_text(x, self.bottom + 22, f"{value:g}", "middle"))
        for value in axis_ticks(self._low[1], self._high[1], (self.bottom - self._top) / 60):
            y = self.bottom - (value - self._low[1]) * self._scale
            parts.append(
                f'<line x1="{self._left - 8:.1f}" x2="{self.right + 8:.1f}" y1="{y:.1f}" y2="{y:.1f}" '
                f'stroke="var(--grid)"/>'
            )
            parts.append(svg_text(self._left - 13, y + 3.5, f"{value:g}", "end"))
        parts.append(svg_text((self._left + self.right) / 2, self.bottom + 38, f"{'xyz'[self._axis]} mm", "middle"))
        parts.append(svg_text(self._left - 8, self._top - 16, f"{'xyz'[self._up]} mm", "start"))
        return parts

    def target(
        self,
        row: Mapping[str, Any],
        centre: NDArray[np.float64],
        axes: NDArray[np.float64],
        length: float,
        largest: float,
    ) -> str:
        """A target's orbit, with its name and numbers to read on hovering.

        Parameters
        ----------
        row
            Of `envelope.csv`.
        centre
            (3,) mm.
        axes
            (2, 3) semi-axes of the orbit, magnified, mm. The shadow of an ellipse is an ellipse; its axes are the
            singular values of theirs.
        length, largest
            Amplitude, and the amplitude at the end of the colour scale, mm.
        """
        (x, y), *_ = self.place(centre[None, :])
        flags = row.get("flags") or []
        title = escape(f"{row['target']}: {length:.3f} mm" + (f" ({', '.join(flags)})" if flags else ""))
        tint = colour(length / largest if largest else 0.0)
        dash = ' stroke-dasharray="3 3"' if flags else ""
        ellipse = self.orbit(centre, axes, f'fill="{tint}" stroke="{tint}"{dash}', title)
        return f'{ellipse}<path d="M{x:.1f} {y:.1f}h0"/>'

    def orbit(self, centre: FloatArray, axes: FloatArray, look: str, title: str = "") -> str:
        """An orbit as an ``<ellipse>``.

        Parameters
        ----------
        centre, axes
            As for `target`.
        look
            Its attributes.
        title
            Escaped text to read on hovering.
        """
        (x, y), *_ = self.place(centre[None, :])
        shadow = self._scale * axes[:, [self._axis, self._up]].T * np.array([[1.0], [-1.0]])
        turn, size, _ = np.linalg.svd(shadow)
        angle = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        return (
            f'<ellipse rx="{max(size[0], _THIN_PX):.1f}" ry="{max(size[1], _THIN_PX):.1f}" '
            f'transform="translate({x:.1f} {y:.1f})rotate({angle:.1f})" {look}>'
            f"{f'<title>{title}</title>' if title else ''}</ellipse>"
        )


def _legend(left: float, top: float, largest: float, motion_scale: float) -> list[str]:
    """Colour bar of the amplitude, and a bar of drawn motion."""
    parts = []
    for band in range(24):
        share = 1 - band / 23
        parts.append(
            f'<rect x="{left:.1f}" y="{top + 18 + band * 5:.1f}" width="12" height="5.4" fill="{colour(share)}"/>'
        )
    parts.append(svg_text(left, top + 8, "amplitude mm", "start"))
    parts += [
        svg_text(left + 18, top + 26 + offset * 114, f"{value:.3g}", "start")
        for offset, value in ((0.0, largest), (0.5, largest / 2), (1.0, 0.0))
    ]
    unit = round_down(40 / motion_scale)
    length, y = unit * motion_scale, top + 180
    parts.append(
        f'<path class="bar-of-motion" stroke="var(--ink)" fill="none" '
        f'd="M{left:.1f} {y - 4:.1f}v8M{left:.1f} {y:.1f}h{length:.1f}m0 -4v8"/>'
    )
    parts.append(svg_text(left, y + 19, f"{unit:g} mm of motion", "start"))
    return parts


def errors_svg(
    captures: Mapping[str, Iterable[TargetComparison]], *, width: float = 760.0, height: float = 260.0
) -> str:
    """Error over true semi-amplitude for every compared target, with a bar of one standard deviation as reported."""
    points = [
        (name, pair)
        for name, pairs in captures.items()
        for pair in pairs
        if pair.error_mm is not None and not set(pair.flags) - {"at_rest"}
    ]
    if not points:
        return "<p>Nothing to compare.</p>"
    left, right, top, bottom = 64.0, width - 190.0, 14.0, height - 40.0
    most = max(pair.true_mm for _, pair in points) * 1.05 or 1.0
    reach = max(abs(pair.error_mm or 0.0) + (pair.sd_mm or 0.0) for _, pair in points) * 1.1 or 1e-3
    names = list(captures)

    def across(value: float) -> float:
        return left + (right - left) * value / most

    def down(value: float) -> float:
        return (top + bottom) / 2 - (bottom - top) / 2 * value / reach

    parts = []
    for value in axis_ticks(-reach, reach, 5):
        parts.append(
            f'<line x1="{left}" x2="{right}" y1="{down(value):.1f}" y2="{down(value):.1f}" '
            f'stroke="var({"--faint" if value == 0 else "--grid"})"/>'
        )
        parts.append(svg_text(left - 6, down(value) + 3.5, f"{value:g}", "end"))
    for value in axis_ticks(0, most, 8):
        parts.append(svg_text(across(value), bottom + 16, f"{value:g}", "middle"))
    parts.append(svg_text((left + right) / 2, bottom + 33, "true semi-amplitude mm", "middle"))
    parts.append(svg_text(14, (top + bottom) / 2, "error mm", "middle", turn=True))
    for name, pair in points:
        tint = colour(names.index(name) / max(len(names) - 1, 1))
        x, error, sd = across(pair.true_mm), pair.error_mm or 0.0, pair.sd_mm or 0.0
        title = escape(f"{name}, {pair.target}: {error:+.4f} mm of {pair.true_mm:.3f} mm, sd {sd:.4f} mm")
        parts.append(
            f'<g stroke="{tint}" fill="{tint}"><title>{title}</title>'
            f'<path d="M{x:.1f} {down(error - sd):.1f}V{down(error + sd):.1f}" stroke-opacity="0.45"/>'
            f'<circle cx="{x:.1f}" cy="{down(error):.1f}" r="3" stroke="none"/></g>'
        )
    for place, name in enumerate(names):
        y = top + 12 + place * 17
        tint = colour(place / max(len(names) - 1, 1))
        parts.append(f'<circle cx="{right + 16:.1f}" cy="{y - 4:.1f}" r="4" fill="{tint}"/>')
        parts.append(svg_text(right + 26, y, name, "start"))
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="Errors over amplitude">{"".join(parts)}</svg>'
    )


def svg_text(x: float, y: float, text: str, anchor: str, *, turn: bool = False) -> str:
    """A ``<text>`` element; `turn` writes upwards."""
    rotation = f' transform="rotate(-90 {x:.1f} {y:.1f})"' if turn else ""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{rotation}>{escape(text)}</text>'


def axis_ticks(low: float, high: float, about: float) -> list[float]:
    """Round values between two ends, roughly `about` of them."""
    step = round_down((high - low) / max(about, 1.0)) or 1.0
    first = math.ceil(low / step - 1e-9)
    return [round(place * step, 12) + 0.0 for place in range(first, math.floor(high / step + 1e-9) + 1)]


def round_down(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above the value."""
    if value <= 0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor for factor in (5, 2, 1) if factor * power <= value * (1 + 1e-9)) * power
