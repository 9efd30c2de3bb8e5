"""Whether the lamp played the code that was stated: what the residuals of coded fits say of each sector's brightness.

The lamp is common to all targets of a frame. Its brightness in each part of the cycle is a parameter that each image
shows a little: the image of that part alone, less the image of the whole, times the change of its share of light. What
the target's own motion and illumination explain is projected out, and the normal equations of all targets add up. A
correction that is far from zero, and large, or constant light that explains the images better, means another code, a
lamp that is not wired, a wrong phase between the frames of a group, or ambient light that flickers with the excitation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.stats import chi2

from labdaemon.blur.light_code import LightCode
from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import ExposureWindow, LightScore
from labdaemon.blur.patch.illumination import paper_level
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.frame_set import FrameSet, TransferFactory, window_orbit_transfer
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import light_parts

_Item = TypeVar("_Item")


def score_light(
    frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory, moment_px2: FloatArray
) -> tuple[LightScore, ...]:
    """One score for each frame under coded light.

    Parameters
    ----------
    frame_set, solution, transfer_factory
        A fit under weights for independent noise.
    moment_px2
        (2, 2) aaᵀ + bbᵀ by the smear's moments.
    """
    constant = _constant_excess(frame_set, solution, moment_px2)
    reach = frame_set.max_amplitude_px(solution.p)
    base, _ = frame_set.forward_model(transfer_factory, reach)(solution.p)
    slope = -paper_level(frame_set.planes, solution.light) * solution.light[:, 3, None, None]
    root = np.sqrt(solution.weight)
    scores = []
    for index, window in enumerate(frame_set.windows):
        if not window.is_coded or window.light is None:
            continue
        rows = frame_set.rows(index)
        columns = []
        for part in _parts_of_cycle(window):
            changed = [*frame_set.windows[:index], part, *frame_set.windows[index + 1 :]]
            shown, _ = replace(frame_set, windows=changed).forward_model(transfer_factory, reach)(solution.p)
            column = np.zeros_like(base)
            column[rows] = (slope * (shown - base) * root)[rows] * _share(window, len(_parts_of_cycle(window)))
            columns.append(column)
        left = _project_out(np.stack(columns), solution)
        scale = max(solution.chi2, LIGHT.min_noise_scale)
        scores.append(LightScore(left @ left.T / scale, left @ solution.residual.ravel() / scale, constant))
    return tuple(scores)


@dataclass(frozen=True, slots=True)
class LightFault:
    """How the light of a frame differed from the code that was stated.

    Attributes
    ----------
    is_constant
        Whether constant light explains the images better than the code.
    rms
        Root mean square of the corrections of the brightness that the images ask for, in parts of the lamp's full
        brightness; 0 under constant light.
    """

    is_constant: bool
    rms: float = 0.0


def find_light_fault(scores: Sequence[LightScore]) -> LightFault | None:
    """How the targets of a frame together contradict its code; None where they do not.

    Single targets with a wrong fit do not speak for all: without those that contradict it most, the others must, too.

    Parameters
    ----------
    scores
        Of the frame's targets, for the same code.
    """
    gain = LIGHT.constant_light_gain
    if sum(max(one.constant_excess, -gain) for one in scores) <= -gain:
        return LightFault(is_constant=True)
    if not scores:
        return None
    cost, limit, rms = _common_correction(scores)
    # Light that flickers faster than the parts of the cycle changes their means little, but shows in each target.
    if cost < limit or (rms < LIGHT.light_mismatch_rms and cost < LIGHT.light_mismatch_cost * len(scores)):
        return None
    others, _, _ = _common_correction(_without_worst(scores, [_own_chi2(one) for one in scores]))
    return LightFault(is_constant=False, rms=rms) if others > LIGHT.least_agreement * cost else None


def _common_correction(scores: Sequence[LightScore]) -> tuple[float, float, float]:
    """Squared standard deviations of the brightness from the code's, their limit, and the rms of the correction."""
    information = np.sum([one.information for one in scores], axis=0)
    score = np.sum([one.score for one in scores], axis=0)
    values, vectors = np.linalg.eigh(information)
    # All parts brighter, or the code turned with all phases, is not seen at all.
    seen = values > LIGHT.light_correction_sd**-2
    if not seen.any():
        return 0.0, math.inf, 0.0
    along = vectors[:, seen].T @ score
    rms = float(np.sqrt(np.sum((along / values[seen]) ** 2) / len(score)))
    limit = float(chi2.isf(LIGHT.light_mismatch_probability, int(seen.sum())))
    return float(np.sum(along**2 / values[seen])), limit, rms


def _own_chi2(one: LightScore) -> float:
    """By how many squared standard deviations a target alone contradicts the code."""
    values, vectors = np.linalg.eigh(one.information)
    seen = values > LIGHT.least_eigenvalue * max(float(values[-1]), 1.0)
    along = vectors[:, seen].T @ one.score
    return float(np.sum(along**2 / values[seen]))


def _without_worst(items: Sequence[_Item], badness: Sequence[float]) -> list[_Item]:
    """The items without those of largest badness, in their order; all where there are few."""
    order = sorted(range(len(items)), key=lambda index: badness[index])
    kept = order[: len(order) - int(LIGHT.outlier_share * len(order))]
    return [items[index] for index in sorted(kept)]


def _constant_excess(frame_set: FrameSet, solution: Solution, moment_px2: FloatArray) -> float:
    """By how many squared standard deviations whole cycles of constant light explain the frames less well."""
    windows = [ExposureWindow(1.0, 1.0) for _ in frame_set.windows]
    plain = replace(frame_set, windows=windows, ambient_held=True)
    values, vectors = np.linalg.eigh(moment_px2)
    minor, major = (np.sqrt(max(value, PHASE.min_moment_px2)) * vectors[:, k] for k, value in enumerate(values))
    start = plain.initial_parameters(major, minor, np.concatenate((major, minor)))
    model = plain.forward_model(window_orbit_transfer, 3.0 + 1.3 * float(np.hypot(*major)))
    kept = solution.weight  # so that costs can be compared
    found = solve(plain.planes, lambda _: kept, model, start, plain.prior(4))
    return (found.cost - solution.cost) / max(solution.chi2, LIGHT.min_noise_scale)


def _parts_of_cycle(window: ExposureWindow) -> list[ExposureWindow]:
    """The exposure with light in one part of the cycle only, for each of some equal parts."""
    light = window.light
    assert light is not None
    sectors = len(light.brightness)
    count = sectors if 3 <= sectors <= LIGHT.light_parts else LIGHT.light_parts
    return [
        replace(
            window,
            light=LightCode(
                tuple(float(index == part) for index in range(count)),
                light.phase_rad,
                light.cycles,
                sd_ambient=light.sd_ambient,
            ),
        )
        for part in range(count)
    ]


def _share(window: ExposureWindow, count: int) -> float:
    """Light of one part of the cycle at full brightness over all light."""
    light, parts = window.light, light_parts(window, 0.0)
    assert light is not None
    return light.cycles / count / (parts.lamp_cycles + light.ambient * parts.room_cycles)


def _project_out(columns: FloatArray, solution: Solution) -> FloatArray:
    """(m, pixels) columns less what the fit's own parameters, illumination included, explain of them."""
    planes, k = len(solution.light), len(solution.p)
    jacobian = solution.whitened_jacobian.astype(np.float64)
    flat = columns.reshape(len(columns), planes, -1)
    own = np.concatenate((jacobian[:, :k].swapaxes(0, 1), flat))
    for plane in range(planes):
        light, _ = np.linalg.qr(jacobian[plane, k:].T)
        own[:, plane] -= (own[:, plane] @ light) @ light.T
    rows = own.reshape(len(own), -1)
    basis, _ = np.linalg.qr(rows[:k].T)
    result: FloatArray = rows[k:] - (rows[k:] @ basis) @ basis.T
    return result
