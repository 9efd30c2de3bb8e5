"""Two states of a structure on the page: the verdict of `labdaemon compare`, and both envelopes in one drawing.

The drawing is Fig. 11 of McCarthy, Chandler and Palmeri (2016), with the states over each other, so that a change shows
without looking from one to the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labdaemon.analysis.campaign_comparison import CampaignComparison, compare_campaigns
from labdaemon.findings.deflection import SAME_FREQUENCY
from labdaemon.orbit_size import is_doubtful
from labdaemon.processing import CaptureFacts
from labdaemon.report.accuracy import row_axes
from labdaemon.report.figures import FLAT_SHARE, FigureView, FloatArray, magnification, svg_text
from labdaemon.report.page_tables import PageGrid
from labdaemon.report.palette import LINE_COLOURS

MAX_FIGURES = 6
"""Frequencies that are drawn: those of a few modes, not a whole sweep."""
MAX_FINDINGS = 20
_HEIGHT = 380.0

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """One state: its envelopes by capture, and what is known of the captures."""

    envelopes: Mapping[str, Rows]
    facts: Mapping[str, CaptureFacts]

    def captures(self) -> list[tuple[float, float | None, Rows]]:
        """Frequency, amplitude of the table and rows of each capture with a frequency, ascending."""
        known = [
            (about.frequency_hz, about.excitation_amplitude_mm, rows)
            for name, rows in self.envelopes.items()
            if (about := self.facts.get(name, CaptureFacts())).frequency_hz is not None
        ]
        return sorted(known, key=lambda one: one[0] or 0.0)


@dataclass(frozen=True, slots=True)
class StateSection:
    """What the page says of the change since a baseline.

    Attributes
    ----------
    baseline
        Name of its folder.
    verdict
        One sentence.
    sentences
        Single differences, what a common change explains, and what could not be compared.
    grid
        A line a pair of modes; None where there were too few steps for modes.
    figures
        Title and SVG for common frequencies.
    others
        Common frequencies that are not drawn.
    """

    baseline: str
    verdict: str
    sentences: tuple[str, ...]
    grid: PageGrid | None
    figures: tuple[tuple[str, str], ...]
    others: int


def state_section(folder: Path, baseline: Path, states: tuple[State, State]) -> StateSection:
    """Compare a data-set folder with its baseline.

    Parameters
    ----------
    folder, baseline
        Data-set folders.
    states
        The baseline's envelopes, then the folder's.

    Raises
    ------
    DataError, ConfigError
        A folder has nothing to compare; the message names it.
    """
    found = compare_campaigns(baseline, folder)
    result = found.comparison
    verdict = "The structure changed" if result.changed else "No change beyond noise and what is the same everywhere"
    sentences = [one.text for one in result.findings[:MAX_FINDINGS]]
    if len(result.findings) > MAX_FINDINGS:
        sentences.append(
            f"{len(result.findings) - MAX_FINDINGS} more differences; `labdaemon compare --json` lists all"
        )
    sentences += [f"explained: {one.text}" for one in result.explained_by] + list(result.notes)
    pairs = _common(*states)
    figures = tuple((f"{pair[0]:g} Hz", state_svg(*pair[1:])) for pair in pairs[:MAX_FIGURES])
    name = baseline.resolve().name
    return StateSection(
        name,
        f"{verdict} (p = {result.p_value:.2g}).",
        tuple(sentences),
        _grid(found),
        figures,
        len(pairs) - len(figures),
    )


def _grid(found: CampaignComparison) -> PageGrid | None:
    if not found.comparison.modes:
        return None
    head = ("baseline Hz", "now Hz", "shift %", "sd %", "damping change %", "sd %", "MAC")
    lines = [
        (
            f"{one.frequency_hz:.4f}",
            f"{one.other_hz:.4f}",
            f"{100 * one.shift:+.4f}",
            f"{100 * one.sd_shift:.4f}",
            f"{100 * one.damping_change:+.1f}",
            f"{100 * one.sd_damping_change:.1f}",
            f"{one.mac.value:.5f}",
        )
        for one in found.comparison.modes
    ]
    return PageGrid(head, lines)


def _common(baseline: State, now: State) -> list[tuple[float, Rows, Rows, float]]:
    """Frequency, rows of both states, and the factor that brings the baseline to the table's amplitude of now."""
    pairs = []
    for frequency, table, rows in now.captures():
        match = next((one for one in baseline.captures() if abs(one[0] / frequency - 1) <= SAME_FREQUENCY), None)
        if match is not None:
            pairs.append((frequency, match[2], rows, table / match[1] if table and match[1] else 1.0))
    return pairs


def state_svg(baseline: Rows, now: Rows, factor: float = 1.0) -> str:
    """Both states of one excitation, from the front and, where the targets do not lie in a plane, from above.

    Parameters
    ----------
    baseline, now
        Rows of `envelope.csv`. Doubtful ones are left out.
    factor
        Of the baseline's amplitudes: the table's now by the table's then.
    """
    sets = [_moving(baseline, factor), _moving(now, 1.0)]
    if not all(len(centres) for centres, _ in sets):
        return "<p>One of the states was not measured at this frequency.</p>"
    places = np.concatenate([centres for centres, _ in sets])
    sizes = [float(np.linalg.norm(pair[0])) for _, axes in sets for pair in axes]
    magnify = magnification(places.tolist(), sizes)
    reach = np.concatenate([magnify * np.sqrt(np.sum(axes**2, axis=1)) for _, axes in sets])
    low, high = (places - reach).min(axis=0), (places + reach).max(axis=0)
    room = 0.06 * float((high - low).max())
    low, high = low - room, high + room
    spans = high - low
    views = [(0, 2)] + ([(0, 1)] if spans[1] - 2 * room > FLAT_SHARE * spans[0] else [])
    margin, left = 46.0, 60.0
    scale = (_HEIGHT - 2 * margin) / float(max(spans[2], 0.35 * spans[0]))
    parts = []
    for axis, up in views:
        view = FigureView(axis, up, left, margin, scale, low, high)
        parts += view.frame()
        for (centres, axes), look in zip(sets, _LOOKS, strict=True):
            parts += [view.orbit(centre, magnify * pair, look) for centre, pair in zip(centres, axes, strict=True)]
        left = view.right + 62.0
    for place, (name, look) in enumerate(zip(("baseline", "now"), _LOOKS, strict=True)):
        y = margin + 8 + 20 * place
        parts.append(f'<ellipse cx="{left - 30:.1f}" cy="{y - 4:.1f}" rx="12" ry="4" {look}/>')
        parts.append(svg_text(left - 12, y, name, "start"))
    parts.append(svg_text(left - 42, margin + 52, f"motion × {magnify:g}", "start"))
    tall = max(float(spans[up]) for _, up in views) * scale + 2 * margin
    width = left + 70
    return (
        f'<svg viewBox="0 0 {width:.0f} {tall:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="Baseline and present state, motion magnified {magnify:g} times">{"".join(parts)}</svg>'
    )


_LOOKS = (
    f'fill="none" stroke="{LINE_COLOURS[0]}" stroke-width="9" stroke-opacity="0.4" stroke-linecap="round"',
    f'fill="none" stroke="{LINE_COLOURS[1]}" stroke-width="1.6"',
)
"""Of baseline and present state: broad and pale below, thin and dark above."""


def _moving(rows: Rows, factor: float) -> tuple[FloatArray, FloatArray]:
    """(n, 3) places and (n, 2, 3) semi-axes of targets without a doubt, mm."""
    found = [
        ([row["x_mm"], row["y_mm"], row["z_mm"]], factor * np.array(axes))
        for row in rows
        if not is_doubtful(row) and row.get("x_mm") is not None and (axes := row_axes(row)) is not None
    ]
    return np.array([place for place, _ in found]).reshape(-1, 3), np.array([axes for _, axes in found])
