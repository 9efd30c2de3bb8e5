"""Two campaigns compared: what their folders have in common is found first, then the states are compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labdaemon.analysis.campaign_response import CampaignResponse, read_campaign
from labdaemon.errors import DataError
from labdaemon.findings import PhaseReference, find_modes
from labdaemon.findings.common_scale import CommonChange
from labdaemon.findings.comparison import Comparison, Difference, as_json, compare_states, with_notes
from labdaemon.findings.deflection import (
    LEAST_COMPONENTS,
    SAME_FREQUENCY,
    common_steps,
    compare_deflections,
    masked_directions,
)
from labdaemon.findings.modal_state import ModalState, state_of
from labdaemon.findings.similarity import Similarity, fit_similarity

MOVED_MM, MOVED_DEG, RESCALED = 1.0, 0.05, 2e-3
"""From here on a change of the targets' mean positions, as a whole, is reported."""
BEYOND = 1.05
"""Ratio of frequencies from which on a campaign went beyond the band of the other."""
DEFORMED_MM = 3.0
"""Mean positions that differ by more after a similarity are of other targets, or targets were moved."""


@dataclass(frozen=True, slots=True)
class CampaignComparison:
    """Outcome of `compare_campaigns`.

    Attributes
    ----------
    comparison
        Of the states.
    kind
        ``modes``, or ``deflections`` where there were too few steps for modes.
    """

    comparison: Comparison
    kind: str

    def to_json(self) -> dict[str, Any]:
        """The object that `labdaemon compare --json` prints."""
        return {"compared": self.kind, **as_json(self.comparison)}


def compare_campaigns(
    baseline: Path, other: Path, *, level_mm: tuple[float, ...] | None = None, same_scale: bool = False
) -> CampaignComparison:
    """Compare two data-set folders.

    Parameters
    ----------
    level_mm
        Heights of the floors; None: those of the targets.
    same_scale
        The user vouches that temperature and amplitude stayed.

    Raises
    ------
    DataError, ConfigError
        A folder has nothing to compare; the message names it.
    """
    first, second = read_campaign(baseline), read_campaign(other)
    first, second, notes, explained = _in_common(first, second)
    states = [_state(one) for one in (first, second)]
    if states[0] is not None and states[1] is not None:
        found = compare_states(
            states[0],
            states[1],
            level_mm=None if level_mm is None else np.array(level_mm),
            same_scale=same_scale,
            free_target_signs=PhaseReference.TARGET in (first.series.phase, second.series.phase),
        )
        if found.modes or not common_steps(first.series, second.series):
            notes += _common_band(first, second)
            found = replace(found, explained_by=(*explained, *found.explained_by))
            return CampaignComparison(with_notes(found, notes), "modes")
        notes += found.notes  # no mode of one state is one of the other: their envelopes can still be compared
    return CampaignComparison(with_notes(_deflections(first, second, explained), notes), "deflections")


def _in_common(
    first: CampaignResponse, second: CampaignResponse
) -> tuple[CampaignResponse, CampaignResponse, list[str], list[CommonChange]]:
    """Both campaigns with the same targets and directions, in the baseline's axes."""
    notes = [*_sameness(first, second), *first.notes, *second.notes]
    for one in (first, second):
        if not one.series.valid().any():
            reason = "; ".join(one.notes) or "all are empty"
            raise DataError(
                f"has no usable motion of any target, so nothing can be compared ({reason})", file=one.folder
            )
    names = [name for name in first.series.targets if name in second.series.targets]
    for one, two in ((first, second), (second, first)):
        alone = [name for name in one.series.targets if name not in two.series.targets]
        if alone:
            listed = ", ".join(alone[:8]) + (" …" if len(alone) > 8 else "")
            notes.append(f"only {one.folder.name} has the targets {listed}: not compared")
    if not names:
        raise DataError(f"has no target of {first.folder}: nothing can be compared", file=second.folder)
    first, second = (_with_targets(one, names) for one in (first, second))
    explained: list[CommonChange] = []
    moved = fit_similarity(*_both_finite(second.positions_mm, first.positions_mm))
    directions = first.directions & second.directions
    if moved is not None and directions.all():
        second, explained = _moved_back(second, moved, notes)
    if not (first.directions == second.directions).all():
        seen = ", ".join(name for name, is_there in zip("xyz", directions, strict=True) if is_there) or "none"
        notes.append(f"one campaign has one camera, the other more: only the directions {seen} are compared")
    if not directions.any():
        raise DataError(
            f"shares no measured direction with {first.folder}: nothing can be compared", file=second.folder
        )
    first, second = (
        replace(one, series=masked_directions(one.series, directions), directions=directions) for one in (first, second)
    )
    return first, second, notes, explained


def _sameness(first: CampaignResponse, second: CampaignResponse) -> list[str]:
    """What makes a comparison of these two say nothing, or less than it could."""
    if first.folder.resolve() == second.folder.resolve():
        return [f"both are the folder {first.folder.name}: nothing can differ"]
    one, two = first.series, second.series
    if one.targets == two.targets and np.array_equal(one.amplitude, two.amplitude, equal_nan=True):
        return ["both have the same numbers to the last digit: one folder is a copy of the other"]
    phased = [each for each in (first, second) if each.series.phase is not PhaseReference.TARGET]
    if len(phased) == 1:
        return [f"only {phased[0].folder.name} shows phases throughout: signs and phases are not compared"]
    return []


def _both_finite(one: np.ndarray, two: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    is_there = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1)
    return one[is_there], two[is_there]


def _with_targets(one: CampaignResponse, names: list[str]) -> CampaignResponse:
    index = np.array([one.series.targets.index(name) for name in names])
    return replace(one, series=one.series.with_targets(index), positions_mm=one.positions_mm[index])


def _moved_back(
    second: CampaignResponse, moved: Similarity, notes: list[str]
) -> tuple[CampaignResponse, list[CommonChange]]:
    """The other campaign in the baseline's axes, and how far its axes were from these."""
    if moved.rms_mm > DEFORMED_MM:
        notes.append(
            f"the targets' mean positions differ by {moved.rms_mm:.1f} mm beyond a rigid motion: "
            "targets were moved, or have other names"
        )
        return second, []
    middle = second.positions_mm[np.isfinite(second.positions_mm).all(axis=1)].mean(axis=0)
    shift = float(np.linalg.norm(moved.scale * moved.rotation @ middle + moved.translation_mm - middle))
    explained = []
    if shift > MOVED_MM or moved.angle_deg > MOVED_DEG or abs(moved.scale - 1) > RESCALED:
        text = (
            f"cameras, survey or structure were moved as a whole: {shift:.1f} mm, {moved.angle_deg:.2f} degrees, "
            f"scale {moved.scale:.4f}; taken out before comparing"
        )
        explained.append(CommonChange("moved", float(np.radians(moved.angle_deg)), 0.0, text))
    matrix = moved.scale * moved.rotation
    series = second.series
    amplitude = np.einsum("de,kte->ktd", matrix, series.amplitude)
    sds = (np.sqrt(np.einsum("de,kte->ktd", matrix**2, sd**2)) for sd in (series.sd_real, series.sd_imag))
    sd_real, sd_imag = sds
    positions = second.positions_mm @ matrix.T + moved.translation_mm
    series = replace(series, amplitude=amplitude, sd_real=sd_real, sd_imag=sd_imag)
    return replace(second, series=series, positions_mm=positions), explained


def _state(one: CampaignResponse) -> ModalState | None:
    found = find_modes(one.series, is_real=True)
    if found.fit is None or not found.modes:
        return None
    return state_of(found.fit, one.positions_mm, one.series.targets)


def _common_band(first: CampaignResponse, second: CampaignResponse) -> list[str]:
    """The band in which both took steps, where one went clearly beyond it: a sweep that was aborted is shorter."""
    bands = [(one.series.frequency_hz.min(), one.series.frequency_hz.max()) for one in (first, second)]
    low, high = max(bands[0][0], bands[1][0]), min(bands[0][1], bands[1][1])
    if all(low / band[0] < BEYOND and band[1] / high < BEYOND for band in bands):
        return []
    return [f"only the band from {low:.4g} to {high:.4g} Hz was measured in both: modes beyond it cannot be compared"]


def _unpaired_steps(first: CampaignResponse, second: CampaignResponse) -> list[str]:
    """Frequencies that only one campaign has: a campaign that was aborted lacks the later ones."""
    pairs = common_steps(first.series, second.series)
    notes = []
    for side, one in enumerate((first, second)):
        paired = {pair[side] for pair in pairs}
        # A frequency that was taken several times is paired once.
        seen = one.series.frequency_hz[list(paired)]
        alone = {
            f"{frequency:.4g}"
            for step, frequency in enumerate(one.series.frequency_hz)
            if step not in paired and not np.any(np.abs(seen / frequency - 1) <= SAME_FREQUENCY)
        }
        if alone:
            listed = ", ".join(sorted(alone, key=float)[:8]) + (" …" if len(alone) > 8 else "")
            notes.append(f"only {one.folder.name} has {listed} Hz: not compared")
    return notes


def _deflections(first: CampaignResponse, second: CampaignResponse, explained: list[CommonChange]) -> Comparison:
    found = compare_deflections(first.series, second.series)
    if found is None and common_steps(first.series, second.series):
        raise DataError(
            f"shares frequencies with {first.folder}, but both measured fewer than {LEAST_COMPONENTS} components of "
            "the same targets, and too few frequencies for modes: nothing can be compared",
            file=second.folder,
        )
    if found is None:
        raise DataError(
            f"has no frequency in common with {first.folder}, and too few for modes: nothing can be compared",
            file=second.folder,
        )
    for frequency, factor, sd in found.scales:
        if abs(factor - 1) > 3 * sd:
            text = f"amplitudes at {frequency:.4g} Hz are {factor:.4f} ± {sd:.4f} times as large (table, resonance)"
            explained.append(CommonChange("amplitude_scale", factor - 1, sd, text))
    findings = tuple(
        Difference(
            "envelope",
            f"{one.target} {one.axis} at {one.frequency_hz:.4g} Hz",
            one.z,
            f"{one.target} moves differently along {one.axis} at {one.frequency_hz:.4g} Hz ({one.z:+.1f} sd)",
        )
        for one in found.differences
    )
    count = len(found.scales)
    notes = (
        f"too few steps for modes: the forms of the envelopes at {count} common frequencies are compared; "
        "frequencies, dampings and storeys are not known",
        *_unpaired_steps(first, second),
    )
    return Comparison(found.changed, found.p_value, findings, tuple(explained), (), (), None, notes)
