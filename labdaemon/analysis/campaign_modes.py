"""The modes that a campaign's envelopes show, with their shapes, and the best frequency of a next step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import qr

from labdaemon.analysis.campaign_response import CampaignResponse, read_campaign
from labdaemon.findings import (
    ModalFit,
    Mode,
    ModeSearch,
    Transmissibility,
    candidate_frequencies,
    find_modes,
    next_frequency,
    transmissibility_of,
)
from labdaemon.findings.modal_state import ModalState, state_of
from labdaemon.findings.mode_shape import (
    ModeShape,
    SectionMotion,
    ShapePoint,
    antinodes,
    curvature,
    mpc,
    nodes,
    section_motions,
    share_along,
)
from labdaemon.findings.propagation import Estimate
from labdaemon.findings.response import FloatArray

SCALING = (
    "residues: mm of the target per mm of the table when multiplied by f²/(f_r² − f² + 2iζ_r f_r f); "
    "mode shape times participation factor"
)

LEAST_TARGETS = 6
"""Targets that are fitted however many steps there are."""


@dataclass(frozen=True, slots=True, eq=False)
class ModeReport:
    """One mode as a person wants it.

    Attributes
    ----------
    mode
        Frequency, damping, evidence.
    shape
        Residue at each target, mm per mm of the table.
    nodes, antinodes
        On each member.
    complex_shape
        The same with imaginary parts, at the phase at which most of it is real; None where residues are real.
    collinearity
        Modal phase collinearity; 1 where residues are real.
    sections
        Sway and torsion at each level with two targets or more.
    curvature
        (member, height in mm, second derivative in 1/mm² per unit of the shape).
    out_of_plane
        Part of the squared motion across the table's direction (along y).
    torsion_per_mm
        Of the highest level with two targets or more; None without one.
    """

    mode: Mode
    shape: ModeShape
    nodes: tuple[ShapePoint, ...]
    antinodes: tuple[ShapePoint, ...]
    complex_shape: ModeShape | None
    collinearity: Estimate
    sections: tuple[SectionMotion, ...]
    curvature: tuple[tuple[int, float, Estimate], ...]
    out_of_plane: Estimate
    torsion_per_mm: Estimate | None

    def to_json(self, targets: tuple[str, ...]) -> dict[str, Any]:
        """Numbers by name; `SCALING` says how shapes are scaled."""
        return {
            "frequency_hz": self.mode.frequency_hz,
            "sd_frequency_hz": self.mode.sd_frequency_hz,
            "damping": self.mode.damping,
            "sd_damping": self.mode.sd_damping,
            "p_value": self.mode.p_value,
            "shape": _shape_json(self.shape, self.complex_shape, targets),
            "mpc": asdict(self.collinearity),
            "sections": [asdict(one) for one in self.sections],
            "curvature": [
                {"member": member, "height_mm": height, "value": one.value, "sd": one.sd}
                for member, height, one in self.curvature
            ],
            "nodes": [{"member": one.member, "height_mm": one.height_mm, "sd_mm": one.sd_mm} for one in self.nodes],
            "antinodes": [
                {"member": one.member, "height_mm": one.height_mm, "sd_mm": one.sd_mm} for one in self.antinodes
            ],
            "out_of_plane": {"value": self.out_of_plane.value, "sd": self.out_of_plane.sd},
            "torsion_per_mm": None
            if self.torsion_per_mm is None
            else {"value": self.torsion_per_mm.value, "sd": self.torsion_per_mm.sd},
        }


def _shape_json(shape: ModeShape, complex_shape: ModeShape | None, targets: tuple[str, ...]) -> dict[str, Any]:
    """Displacements of each target with sd; imaginary parts where there are any."""
    sd = _spread(shape).reshape(len(targets), -1)
    parts = {"value": shape.vectors.real, "sd": sd}
    if complex_shape is not None:
        size = len(complex_shape.values) // 2
        spread = _spread(complex_shape)[size:].reshape(len(targets), -1)
        parts |= {"imag": complex_shape.vectors.imag, "sd_imag": spread}
    return {name: {part: rows[place].tolist() for part, rows in parts.items()} for place, name in enumerate(targets)}


def _spread(shape: ModeShape) -> FloatArray:
    result: FloatArray = np.sqrt(np.maximum(np.diag(shape.covariance), 0.0))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class CampaignModes:
    """What a folder's envelopes show.

    Attributes
    ----------
    targets
        Names.
    modes
        In ascending frequency; empty where there is none.
    transmissibility
        Of every target at every step.
    next_hz
        Frequency of the step that would give most information on the poles; None without modes.
    notes
        Why there are no more modes, and what was left out.
    fit
        The fitted model, for its curves; None without modes.
    """

    targets: tuple[str, ...]
    modes: tuple[ModeReport, ...]
    transmissibility: Transmissibility
    next_hz: float | None
    notes: tuple[str, ...]
    fit: ModalFit | None = None

    def to_json(self) -> dict[str, Any]:
        """The object that `labdaemon modes --json` prints."""
        return {
            "scaling": SCALING,
            "modes": [one.to_json(self.targets) for one in self.modes],
            "transmissibility": self.transmissibility.to_json(),
            "next_hz": self.next_hz,
            "notes": list(self.notes),
        }


def campaign_modes(folder: Path) -> CampaignModes:
    """Find the modes in a data-set folder's results.

    Raises
    ------
    DataError, ConfigError
        The folder has no usable envelopes; the message names it.
    """
    return modes_of(read_campaign(folder))


def modes_of(campaign: CampaignResponse, *, most_readings: int | None = None) -> CampaignModes:
    """Find the modes in a campaign's envelopes.

    Parameters
    ----------
    campaign
        From `read_campaign`.
    most_readings
        Steps times targets up to which all targets are fitted: the time of the search grows with them. Beyond, a note
        says how many are fitted: those that differ most from each other. None: all.
    """
    ratio = transmissibility_of(campaign.series)
    fitted = campaign if most_readings is None else _most_different(campaign, most_readings)
    found = find_modes(fitted.series)
    notes = (*fitted.notes, *found.reasons)
    if found.fit is None or not found.modes:
        return CampaignModes(fitted.series.targets, (), ratio, None, notes)
    state = state_of(found.fit, fitted.positions_mm, fitted.series.targets)
    reports = tuple(_report(state, found.fit, index, mode) for index, mode in enumerate(found.modes))
    return CampaignModes(fitted.series.targets, reports, ratio, _next(fitted, found), notes, found.fit)


def _most_different(campaign: CampaignResponse, most_readings: int) -> CampaignResponse:
    """The campaign with so many targets that steps times targets stay below a number, but at least `LEAST_TARGETS`."""
    series = campaign.series
    total, count = len(series.targets), max(most_readings // series.steps, LEAST_TARGETS)
    if count >= total:
        return campaign
    size = np.sqrt(np.nansum(np.abs(series.amplitude) ** 2, axis=2)) / series.table_mm[:, None]
    _, order = qr(size, mode="r", pivoting=True)  # each next column is the one furthest from those before
    chosen = np.sort(order[:count])
    note = f"the {count} of {total} targets that differ most were fitted; `labdaemon modes` fits all"
    return replace(
        campaign,
        series=series.with_targets(chosen),
        positions_mm=campaign.positions_mm[chosen],
        notes=(*campaign.notes, note),
    )


def _report(state: ModalState, fitted: ModalFit, index: int, mode: Mode) -> ModeReport:
    size = state.shapes[index].size
    part = slice(2 * state.modes + index * size, 2 * state.modes + (index + 1) * size)
    shape = ModeShape(state.shapes[index].ravel(), state.covariance[part, part], state.positions_mm)
    whole = ModeShape.of(fitted, mode.index, state.positions_mm).turned_real()
    sections = section_motions(shape)
    return ModeReport(
        mode,
        shape,
        tuple(nodes(shape)),
        tuple(antinodes(shape)),
        whole if whole.is_complex else None,
        mpc(whole),
        tuple(sections),
        tuple(curvature(shape)),
        share_along(shape, 1),
        sections[-1].torsion_per_mm if sections else None,
    )


def _next(campaign: CampaignResponse, found: ModeSearch) -> float | None:
    if found.fit is None:
        return None
    series = campaign.series
    band = (float(series.frequency_hz.min()), float(series.frequency_hz.max()))
    sd = float(np.median(series.sd_real[series.valid()]))
    table, sd_table = float(np.median(series.table_mm)), float(np.median(series.sd_table))
    candidates = candidate_frequencies(found.fit, band)
    step = next_frequency(found.fit, candidates, sd_mm=sd, sd_table=sd_table, table_mm=table)
    return None if step is None else step.frequency_hz
