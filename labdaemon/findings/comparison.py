"""Two states of a structure compared: what changed beyond noise and beyond what a common change explains, and where."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from labdaemon.findings.assurance import Assurance, comac, mac
from labdaemon.findings.common_scale import CommonChange, CommonFit, fit_common
from labdaemon.findings.locate import (
    Explanation,
    ShearModel,
    explained_share,
    explanations,
    inseparable,
    matched_rows,
    shear_model,
)
from labdaemon.findings.max_statistic import MaxTest, max_test
from labdaemon.findings.modal_state import ModalState, align_signs, pair_modes
from labdaemon.findings.mode_shape import ModeShape, curvature_rows, nodes
from labdaemon.findings.response import FloatArray

SHAPE_FLOOR = 1e-3
"""Systematic part of a shape's component, of its largest, that two surveys and orientations leave: not in any sd."""

LEAST_STOREY_Z = 3.0
"""A storey is named from so many sd of its change on."""
LEAST_EXPLAINED = 0.7
"""Share of the differences' χ² below which a single change is no good explanation."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A difference that exceeds its share of the false-alarm rate.

    Attributes
    ----------
    what
        ``frequency``, ``damping``, ``shape``, ``curvature``, ``stiffness``, ``mass`` or ``mode``.
    where
        Mode, target, storey or level.
    z
        Standardised difference.
    text
        One sentence.
    """

    what: str
    where: str
    z: float
    text: str


@dataclass(frozen=True, slots=True)
class NodeShift:
    """A node that moved along its member.

    Attributes
    ----------
    member, height_mm
        Index of the member, and the node's height in the baseline.
    shift_mm, sd_mm
        Height in the other state minus that in the baseline.
    """

    member: int
    height_mm: float
    shift_mm: float
    sd_mm: float

    @property
    def z(self) -> float:
        """Shift over its sd."""
        return self.shift_mm / self.sd_mm if self.sd_mm > 0 else 0.0


@dataclass(frozen=True, slots=True)
class ModeChange:
    """One pair of modes.

    Attributes
    ----------
    frequency_hz, other_hz
        Of both states.
    shift, sd_shift, damping_change, sd_damping_change
        Relative, common changes included.
    mac
        Modal assurance criterion.
    node_shifts
        Of each node that both states have.
    """

    frequency_hz: float
    other_hz: float
    shift: float
    sd_shift: float
    damping_change: float
    sd_damping_change: float
    mac: Assurance
    node_shifts: tuple[NodeShift, ...]

    @property
    def z_shift(self) -> float:
        """Shift of the frequency over its sd, common changes included."""
        return self.shift / self.sd_shift if self.sd_shift > 0 else 0.0

    @property
    def z_damping_change(self) -> float:
        """Change of the damping over its sd, common changes included."""
        return self.damping_change / self.sd_damping_change if self.sd_damping_change > 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Outcome of a comparison.

    Attributes
    ----------
    changed, p_value
        Whether the structure changed, at a false-alarm rate of 5 % over everything tested.
    findings
        Single differences, the largest first.
    explained_by
        Common changes.
    modes
        Pairs of modes.
    storeys
        Explanations that cannot be separated, the best first; empty where nothing changed or no storeys are known.
    model
        The shear frame of the baseline, None where there is none.
    notes
        What could not be compared, and why.
    comac
        By target, of its direction with the lowest z-score; targets that hardly move have none.
    """

    changed: bool
    p_value: float
    findings: tuple[Difference, ...]
    explained_by: tuple[CommonChange, ...]
    modes: tuple[ModeChange, ...]
    storeys: tuple[Explanation, ...]
    model: ShearModel | None
    notes: tuple[str, ...] = ()
    comac: dict[str, Assurance] = field(default_factory=dict)


def compare_states(
    baseline: ModalState,
    other: ModalState,
    *,
    level_mm: FloatArray | None = None,
    same_scale: bool = False,
    is_fixed: bool = True,
    free_target_signs: bool = True,
) -> Comparison:
    """Compare two states that have the same targets, in the same axes.

    Parameters
    ----------
    level_mm
        Heights of the floors; None: those of the targets.
    same_scale
        Temperature and table amplitude are vouched for, so that a common change counts as a change.
    is_fixed
        Whether the structure stands on the table.
    free_target_signs
        Whether each target's sign is its own (amplitudes without phase).
    """
    pairs = pair_modes(baseline, other)
    notes = _unpaired(baseline, other, pairs)
    if not pairs:
        notes += ["no mode of one campaign is one of the other: nothing can be compared"]
        return Comparison(False, 1.0, (), (), (), (), None, tuple(notes))
    every = np.arange(len(baseline.targets))
    first = baseline.subset(np.array([i for i, _ in pairs]), every)
    second = align_signs(first, other.subset(np.array([j for _, j in pairs]), every), targets_too=free_target_signs)
    difference = second.vector() - first.vector()
    floored = tuple(replace(one, covariance=one.covariance + 0.5 * _floor(first)) for one in (first, second))
    covariance = floored[0].covariance + floored[1].covariance
    common = fit_common(first, difference, covariance, same_scale=same_scale)
    model = shear_model(first, level_mm, is_fixed=is_fixed)
    rows, labels = _test_rows(first, common, model)
    test = max_test(rows, common.rest, common.covariance, [label[0] for label in labels])
    found = explanations(model, common, difference) if model is not None else []
    storeys = inseparable(found) if test.is_changed and found else []
    if storeys and explained_share(found, common) < LEAST_EXPLAINED:
        notes.append("no change of one storey or level explains most of the differences; the best are named")
    return Comparison(
        test.is_changed,
        test.p_value,
        tuple(_findings(test, labels, storeys)),
        common.changes,
        tuple(_mode_changes(*floored)),
        tuple(storeys),
        model,
        tuple(notes),
        comac(*floored),
    )


def _floor(state: ModalState) -> FloatArray:
    """Variance of what differs between two surveys without a change."""
    largest = np.abs(state.shapes).max(axis=(1, 2), keepdims=True) * np.ones(state.shapes.shape)
    variance = np.concatenate([np.zeros(2 * state.modes), (SHAPE_FLOOR * largest.ravel()) ** 2])
    return np.diag(variance)


def _unpaired(baseline: ModalState, other: ModalState, pairs: list[tuple[int, int]]) -> list[str]:
    notes = []
    for name, state, side in (("baseline", baseline, 0), ("other", other, 1)):
        alone = sorted(set(range(state.modes)) - {pair[side] for pair in pairs})
        notes += [f"the mode at {state.frequency_hz[i]:.4g} Hz is only in the {name} campaign" for i in alone]
    return notes


Label = tuple[str, str]


def _test_rows(state: ModalState, common: CommonFit, model: ShearModel | None) -> tuple[FloatArray, list[Label]]:
    """All that is tested: rows over the state's vector, and (group, place) of each."""
    modes, length = state.modes, len(state.vector())
    names = [f"mode {i + 1} ({f:.4g} Hz)" for i, f in enumerate(state.frequency_hz)]
    rows = [np.eye(length)]
    labels: list[Label] = [("frequency", name) for name in names] + [("damping", name) for name in names]
    axes = "xyz"[: state.shapes.shape[2]]
    labels += [("shape", f"{target} {axis}, {name}") for name in names for target in state.targets for axis in axes]
    for mode in range(modes):
        size = state.shapes[0].size
        shape = ModeShape(state.shapes[mode].ravel(), np.zeros((0, 0)), state.positions_mm)
        inner, places = curvature_rows(shape)
        block = np.zeros((len(inner), length))
        block[:, 2 * modes + mode * size : 2 * modes + (mode + 1) * size] = inner
        rows.append(block)
        labels += [("curvature", f"member {m + 1} at {height:.0f} mm, {names[mode]}") for m, height in places]
    if model is not None:
        rows.append(matched_rows(model, common))
        labels += list(zip(["storey"] * len(model.kinds), model.places, strict=True))
    return np.concatenate(rows), labels


def _findings(test: MaxTest, labels: list[Label], storeys: list[Explanation]) -> list[Difference]:
    if not test.is_changed:
        return []
    found = []
    for one in storeys:
        z = one.change / one.sd if one.sd > 0 else 0.0
        if abs(z) < LEAST_STOREY_Z:
            continue  # something changed, but no storey
        text = f"{one.kind} of {one.where} changed by {100 * one.change:+.2f} ± {100 * one.sd:.2f} %"
        if len(storeys) > 1:
            text += f", or another of {len(storeys)} that cannot be separated"
        found.append(Difference(one.kind, one.where, z, text))
    single = [
        Difference(what, where, float(z), f"{what} of {where} differs by {z:+.1f} of its standard deviations")
        for (what, where), z, limit in zip(labels, test.z, test.critical, strict=True)
        if abs(z) > limit and what != "storey"
    ]
    return found + sorted(single, key=lambda one: -abs(one.z))


def _mode_changes(first: ModalState, second: ModalState) -> list[ModeChange]:
    found = []
    size, modes = first.shapes[0].size, first.modes
    sd = np.sqrt(np.diag(first.covariance) + np.diag(second.covariance))
    for mode in range(modes):
        part = slice(2 * modes + mode * size, 2 * modes + (mode + 1) * size)
        ones, others = (
            ModeShape(state.shapes[mode].ravel(), state.covariance[part, part], state.positions_mm)
            for state in (first, second)
        )
        shift = float(second.log_frequency[mode] - first.log_frequency[mode])
        damping = float(second.log_damping[mode] - first.log_damping[mode])
        found.append(
            ModeChange(
                float(first.frequency_hz[mode]),
                float(second.frequency_hz[mode]),
                shift,
                float(sd[mode]),
                damping,
                float(sd[modes + mode]),
                mac(ones, others),
                _node_shifts(ones, others),
            )
        )
    return found


def _node_shifts(one: ModeShape, other: ModeShape) -> tuple[NodeShift, ...]:
    """Movement of nodes that both shapes have, each with its nearest."""
    before, after = nodes(one), nodes(other)
    shifts = []
    for node in before:
        near = [each for each in after if each.member == node.member]
        if near:
            best = min(near, key=lambda each: abs(each.height_mm - node.height_mm))
            shift, sd = best.height_mm - node.height_mm, float(np.hypot(node.sd_mm, best.sd_mm))
            shifts.append(NodeShift(node.member, node.height_mm, shift, sd))
    return tuple(shifts)


def as_json(found: Comparison) -> dict[str, Any]:
    """The contract's object, and more."""
    return {
        "changed": found.changed,
        "p_value": found.p_value,
        "findings": [{"what": one.what, "where": one.where, "z": one.z, "text": one.text} for one in found.findings],
        "explained_by": [
            {"what": one.what, "value": one.value, "sd": one.sd, "z": one.z, "text": one.text}
            for one in found.explained_by
        ],
        "inseparable": [one.where for one in found.storeys],
        "modes": [_mode_json(one) for one in found.modes],
        "comac": {name: asdict(one) for name, one in found.comac.items()},
        "shear_frame": _shear_json(found.model),
        "notes": list(found.notes),
    }


def _mode_json(one: ModeChange) -> dict[str, Any]:
    return {
        "frequency_hz": one.frequency_hz,
        "other_hz": one.other_hz,
        "shift": one.shift,
        "sd_shift": one.sd_shift,
        "z_shift": one.z_shift,
        "damping_change": one.damping_change,
        "sd_damping_change": one.sd_damping_change,
        "z_damping_change": one.z_damping_change,
        "mac": one.mac.value,
        "sd_mac": one.mac.sd,
        "z_mac": one.mac.z,
        "node_shifts": [{**asdict(node), "z": node.z} for node in one.node_shifts],
    }


def _shear_json(model: ShearModel | None) -> list[dict[str, Any]]:
    if model is None:
        return []
    return [
        {
            "level_mm": model.level_mm.tolist(),
            "relative_stiffness": np.exp(one.frame.log_stiffness - one.frame.log_stiffness.mean()).tolist(),
            "sd_stiffness": one.sd_log_stiffness.tolist(),
            "relative_mass": np.exp(one.frame.log_mass).tolist(),
            "sd_mass": one.sd_log_mass.tolist(),
        }
        for one in model.fits
    ]


def with_notes(found: Comparison, notes: list[str]) -> Comparison:
    """The comparison with more notes, first."""
    return replace(found, notes=(*notes, *found.notes))
