"""Resonances of the page: a table of the modes, and the curves of the fitted model for the chart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from labdaemon.analysis.campaign_modes import CampaignModes, campaign_modes
from labdaemon.errors import ConfigError, DataError
from labdaemon.findings.fitted_response import curve_frequencies, fitted_response
from labdaemon.orbit_size import semi_major_axis
from labdaemon.report.frequency_chart import Curve
from labdaemon.report.page_tables import PageGrid

LEAST_FREQUENCIES = 4
"""A mode has four parameters even at one target: fewer frequencies cannot show one."""
MOST_READINGS = 300
"""Steps times targets that are fitted: more takes longer than a person waits for a page."""


@dataclass(frozen=True, slots=True)
class ResonanceSection:
    """What the page says of resonances.

    Attributes
    ----------
    grid
        A line a mode; None where none was found.
    curves
        Modelled amplitude per amplitude of the table over frequency, by target.
    notes
        Why there are no more modes, and what was left out.
    """

    grid: PageGrid | None = None
    curves: Mapping[str, Curve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def resonance_section(folder: Path, results: Path) -> ResonanceSection:
    """Look for modes in the results of a data-set folder; the notes say why there are none."""
    try:
        found = campaign_modes(folder, results, most_readings=MOST_READINGS)
    except (DataError, ConfigError) as exc:
        return ResonanceSection(notes=(str(exc),))
    return ResonanceSection(_grid(found) if found.modes else None, _curves(found), found.notes)


def _grid(found: CampaignModes) -> PageGrid:
    head = ("mode", "frequency Hz", "sd Hz", "damping %", "sd %", "out of plane %", "nodes at height mm")
    lines = [
        (
            str(number),
            f"{one.mode.frequency_hz:.4f}",
            f"{one.mode.sd_frequency_hz:.4f}",
            f"{100 * one.mode.damping:.3f}",
            f"{100 * one.mode.sd_damping:.3f}",
            f"{100 * one.out_of_plane.value:.1f}",
            ", ".join(f"{node.height_mm:.1f} ± {node.sd_mm:.1f}" for node in one.nodes) or "none",
        )
        for number, one in enumerate(found.modes, start=1)
    ]
    return PageGrid(head, lines)


def _curves(found: CampaignModes) -> dict[str, list[tuple[float, float]]]:
    if found.fit is None:
        return {}
    frequencies = curve_frequencies(found.fit)
    response = fitted_response(found.fit, frequencies)
    return {
        target: [
            (float(frequency), semi_major_axis(value.real.tolist(), value.imag.tolist()))
            for frequency, value in zip(frequencies, response[:, place], strict=True)
        ]
        for place, target in enumerate(found.targets)
    }
