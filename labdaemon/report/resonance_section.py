"""Response of the structure on the page: transmissibility of each target, the modes, and the curves of their model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from labdaemon.analysis.campaign_modes import CampaignModes, modes_of
from labdaemon.analysis.campaign_response import read_campaign
from labdaemon.errors import ConfigError, DataError
from labdaemon.findings import Transmissibility, transmissibility_of
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
    transmissibility
        A line a target: its largest amplitude per amplitude of the table; None where that is not known.
    is_searched
        Whether there were enough frequencies to look for modes.
    curves
        Modelled amplitude per amplitude of the table over frequency, by target.
    notes
        Why there are no more modes, and what was left out.
    """

    grid: PageGrid | None = None
    transmissibility: PageGrid | None = None
    is_searched: bool = False
    curves: Mapping[str, Curve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def resonance_section(folder: Path, results: Path) -> ResonanceSection:
    """Look for modes in the results of a data-set folder; the notes say why there are none."""
    try:
        campaign = read_campaign(folder, results)
        ratios = _transmissibility(transmissibility_of(campaign.series))
        if len(set(campaign.series.frequency_hz.tolist())) < LEAST_FREQUENCIES:
            return ResonanceSection(transmissibility=ratios)
        found = modes_of(campaign, most_readings=MOST_READINGS)
    except (DataError, ConfigError) as exc:
        return ResonanceSection(notes=(str(exc),))
    grid = _grid(found) if found.modes else None
    return ResonanceSection(grid, ratios, is_searched=True, curves=_curves(found), notes=found.notes)


def _transmissibility(ratios: Transmissibility) -> PageGrid | None:
    """The largest of each target; a target without any has no line."""
    lines = []
    for place, target in enumerate(ratios.targets):
        values = ratios.value[:, place]
        if np.isfinite(values).any():
            step = int(np.nanargmax(values))
            number = f"{values[step]:.4f}", f"{ratios.sd[step, place]:.4f}", f"{ratios.frequency_hz[step]:.4f}"
            lines.append((target, *number))
    return PageGrid(("target", "largest transmissibility", "sd", "at Hz"), lines) if lines else None


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
