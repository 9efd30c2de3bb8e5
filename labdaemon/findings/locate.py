"""Which storey changed: each storey's stiffness, and each level's mass, alone as explanation of the differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.common_scale import CommonFit, inverse
from labdaemon.findings.members import levels as distinct_levels
from labdaemon.findings.modal_state import ModalState
from labdaemon.findings.response import FloatArray
from labdaemon.findings.shear_frame import (
    ShearFit,
    ShearObservation,
    fit_shear_frame,
    interpolation,
    sensitivities,
)

INSEPARABLE_CHI2 = 4.0
"""Explanations whose χ² exceeds the best one's by less cannot be separated from it (95 % of a normal number: 3.84)."""
MOST_LEVELS = 12
OWN_SHARE = 1e-6
"""Part of a change's information that must be left after the common changes; less is rounding."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One change that could be behind the differences.

    Attributes
    ----------
    kind
        ``stiffness`` of a storey or ``mass`` of a level.
    index
        Its place in the model, from 1: storeys from the lowest up, then levels.
    where
        In words, with heights.
    change, sd
        Relative change.
    chi2
        What it leaves unexplained.
    """

    kind: str
    index: int
    where: str
    change: float
    sd: float
    chi2: float


@dataclass(frozen=True, slots=True, eq=False)
class ShearModel:
    """A structure's storeys and what changes of them do.

    Attributes
    ----------
    level_mm
        (n,) heights.
    fits
        Fitted frame for each direction of motion.
    directions
        (q, n) effect on the state's vector of a relative change of 1, of each storey's stiffness and each level's mass.
    kinds, places
        (q,) what each is.
    """

    level_mm: FloatArray
    fits: tuple[ShearFit, ...]
    directions: FloatArray
    kinds: tuple[str, ...]
    places: tuple[str, ...]


def shear_model(state: ModalState, level_mm: FloatArray | None, *, is_fixed: bool = True) -> ShearModel | None:
    """Fit a shear frame to a state; None where its modes or targets do not allow it.

    Parameters
    ----------
    level_mm
        Heights of the floors; None: the heights of the targets stand for them, with straight columns between.
    is_fixed
        Whether the structure stands on the table.
    """
    heights = distinct_levels(state.positions_mm) if level_mm is None else np.asarray(level_mm, float)
    if level_mm is None and len(heights) > MOST_LEVELS:
        heights = heights[np.linspace(0, len(heights) - 1, MOST_LEVELS).round().astype(int)]
    least = 2 if is_fixed else 3
    if state.modes == 0 or len(heights) < least or state.shapes.shape[2] != 3:
        return None
    storeys = len(heights) if is_fixed else len(heights) - 1
    directions = np.zeros((storeys + len(heights), len(state.vector())))
    fits = []
    for every, axis in _groups(state):
        orders = _observation(state, every, axis, heights, is_fixed=is_fixed, clamped=level_mm is not None).orders
        group = every[orders < storeys]  # a chain of so many levels has no more modes
        if not group.size:
            continue
        observed = _observation(state, group, axis, heights, is_fixed=is_fixed, clamped=level_mm is not None)
        fitted = fit_shear_frame(observed, len(heights), is_fixed=is_fixed)
        by_omega, by_shape = sensitivities(fitted, observed)
        fits.append(fitted)
        size = state.shapes[0].size
        directions[:, group] += by_omega
        for place, mode in enumerate(group):
            vector = state.shapes[mode].T @ (state.shapes[mode] @ axis)
            vector = vector / max(float(vector @ axis), 1e-300)
            along = by_shape[:, place][:, :, None] * vector[None, None, :]
            start = 2 * state.modes + mode * size
            directions[:, start : start + size] += along.reshape(len(directions), -1)
    if not fits:
        return None
    whole = np.zeros((1, directions.shape[1]))
    whole[0, : state.modes] = 0.5
    kinds, places = _names(heights, storeys, is_fixed)
    return ShearModel(
        heights,
        tuple(fits),
        np.vstack([directions, whole]),
        (*kinds, "stiffness"),
        (*places, "all storeys (or less mass everywhere)"),
    )


def _names(heights: FloatArray, storeys: int, is_fixed: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    knots = np.concatenate([[0.0], heights]) if is_fixed else heights
    places = [f"storey {i + 1} ({knots[i]:.0f} to {knots[i + 1]:.0f} mm)" for i in range(storeys)]
    places += [f"level {i + 1} ({height:.0f} mm)" for i, height in enumerate(heights)]
    return ("stiffness",) * storeys + ("mass",) * len(heights), tuple(places)


def _groups(state: ModalState) -> list[tuple[np.ndarray, FloatArray]]:
    """Modes by their horizontal direction: along the first mode's, and across it."""
    moments = [shape[:, :2].T @ shape[:, :2] for shape in state.shapes]
    first = np.linalg.eigh(moments[0])[1][:, -1]
    share = np.array([first @ moment @ first / max(np.trace(moment), 1e-300) for moment in moments])
    axes = (np.array([*first, 0.0]), np.array([-first[1], first[0], 0.0]))
    groups = (np.flatnonzero(share >= 0.5), np.flatnonzero(share < 0.5))
    return [(group, axis) for group, axis in zip(groups, axes, strict=True) if group.size]


def _observation(
    state: ModalState, group: np.ndarray, axis: FloatArray, heights: FloatArray, *, is_fixed: bool, clamped: bool
) -> ShearObservation:
    """Frequencies and shapes of some modes along a direction; the number of sign changes says which mode each is."""
    at_levels = interpolation(state.positions_mm[:, 2], heights, is_fixed=is_fixed, clamped=clamped)
    shapes = state.shapes[group] @ axis
    variance = np.diag(state.covariance)
    size, dimension = state.shapes[0].size, state.shapes.shape[2]
    sd = []
    for mode in group:
        start = 2 * state.modes + mode * size
        sd.append(np.sqrt(variance[start : start + size].reshape(-1, dimension) @ axis**2))
    floors = np.linalg.lstsq(at_levels, shapes.T, rcond=1e-6)[0].T
    large = np.where(np.abs(floors) > 0.05 * np.abs(floors).max(axis=1, keepdims=True), np.sign(floors), 0)
    changes = np.array([np.count_nonzero(np.diff(row[row != 0])) for row in large])
    orders = changes if is_fixed else changes - 1
    for place in range(1, len(orders)):  # two modes of one kind: the higher one is the next
        orders[place] = max(orders[place], orders[place - 1] + 1)
    return ShearObservation(
        orders.astype(float),
        np.log(2 * np.pi) + state.log_frequency[group],
        shapes,
        at_levels,
        np.sqrt(variance[group]),
        np.array(sd),
    )


def explanations(model: ShearModel, common: CommonFit, difference: FloatArray) -> list[Explanation]:
    """All single changes, the best first."""
    before = float(common.rest @ common.weight @ common.rest)
    found = []
    own, information = own_directions(model, common)
    for number, (kind, place) in enumerate(zip(model.kinds, model.places, strict=True)):
        if information[number] > 0:
            change = float(own[number] @ common.weight @ difference) / information[number]
            chi2 = before - change**2 * information[number]
            found.append(Explanation(kind, number + 1, place, change, float(information[number] ** -0.5), chi2))
    return sorted(found, key=lambda one: one.chi2)


def explained_share(found: list[Explanation], common: CommonFit) -> float:
    """Part of what the common changes leave that the best single explanation explains."""
    before = float(common.rest @ common.weight @ common.rest)
    return 1.0 - found[0].chi2 / before if before > 0 else 0.0


def inseparable(found: list[Explanation]) -> list[Explanation]:
    """The best explanation and those that cannot be separated from it."""
    return [one for one in found if one.chi2 <= found[0].chi2 + INSEPARABLE_CHI2]


def own_directions(model: ShearModel, common: CommonFit) -> tuple[FloatArray, FloatArray]:
    """(q, n) effects of each change beyond what a common change explains, and (q,) the information on it.

    A change that is itself a common one, such as of all storeys, has nothing of its own: zeros.
    """
    weight, columns = common.weight, common.columns
    inner = inverse(columns.T @ weight @ columns)
    own = model.directions - (model.directions @ weight @ columns) @ inner @ columns.T
    information = np.einsum("qn,nm,qm->q", own, weight, own, optimize=True)
    whole = np.einsum("qn,nm,qm->q", model.directions, weight, model.directions, optimize=True)
    is_own = information > OWN_SHARE * whole
    return np.where(is_own[:, None], own, 0.0), np.where(is_own, information, 0.0)


def matched_rows(model: ShearModel, common: CommonFit) -> FloatArray:
    """(q, n) rows that estimate each change alone: the most powerful test against it."""
    result: FloatArray = own_directions(model, common)[0] @ common.weight
    return result
