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
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import PHASE
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.frame_set import FrameSet, TransferFactory, window_orbit_transfer
from labdaemon.blur.smear.gls_frames import frame_products
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import light_parts
from labdaemon.least_squares import scaled_inverse

_Item = TypeVar("_Item")


def score_light(
    frame_set: FrameSet,
    solution: Solution,
    transfer_factory: TransferFactory,
    moment_px2: FloatArray,
    by_parameters: FloatArray,
    covariance_px2: FloatArray,
) -> tuple[LightScore, ...]:
    """One score for each frame under coded light.

    Parameters
    ----------
    frame_set, solution, transfer_factory
        A fit under weights for independent noise.
    moment_px2
        (2, 2) aaᵀ + bbᵀ by the smear's moments.
    by_parameters
        (6, k) derivatives of x, y, ax, ay, bx, by by the parameters.
    covariance_px2
        (6, 6) of x, y, ax, ay, bx, by, as reported.
    """
    constant = _constant_excess(frame_set, solution, moment_px2)
    scale = max(solution.chi2, LIGHT.min_noise_scale)
    if isinstance(frame_set.sharp.form, TexturedPatch) or not frame_set.sharp.noise_known:
        scale *= LIGHT.unknown_noise_scale
    columns = {
        index: _part_columns(frame_set, solution, transfer_factory, index)
        for index, window in enumerate(frame_set.windows)
        if window.is_coded
    }
    prior = frame_set.prior(len(solution.p) - frame_set.first_motion)
    normal, pull = prior.precision.copy(), -prior.precision @ (solution.p - prior.mean)
    seen = []
    for index, (own, products, _) in enumerate(frame_products(frame_set, solution, transfer_factory, None, columns)):
        k = len(own)
        normal[np.ix_(own, own)] += products[:k, :k]
        pull[own] += products[:k, -1]
        if index in columns:
            cross = np.zeros((len(columns[index]), len(solution.p)))
            cross[:, own] = products[k:-1, :k]
            seen.append((products[k:-1, k:-1], products[k:-1, -1], cross))
    covariance = scaled_inverse(normal)
    whiten = _whitening(covariance_px2[2:, 2:])
    scores = []
    for information, score, cross in seen:
        response = -covariance @ cross.T
        scores.append(
            LightScore(
                (information + cross @ response) / scale,
                (score + response.T @ pull) / scale,
                constant,
                whiten @ (by_parameters @ response)[2:],
            )
        )
    return tuple(scores)


def _whitening(covariance: FloatArray) -> FloatArray:
    """(4, 4) that takes a change of a and b to standard deviations."""
    values, vectors = np.linalg.eigh(covariance)
    least = LIGHT.least_eigenvalue * max(float(values[-1]), 1e-300)
    result: FloatArray = (vectors / np.sqrt(np.maximum(values, least))).T
    return result


def _part_columns(frame_set: FrameSet, solution: Solution, transfer_factory: TransferFactory, index: int) -> FloatArray:
    """(m, n, h, w) change of one frame's darkness by the brightness in each part of the cycle."""
    window, rows = frame_set.windows[index], frame_set.rows(index)
    reach = frame_set.max_amplitude_px(solution.p)
    p, correction = solution.p.copy(), 0.0
    base, _ = frame_set.forward_model(transfer_factory, reach)(p)
    if frame_set.ambient_count:
        # One part of the cycle alone has no ambient light.
        correction = float(p[frame_set.first_motion - 1])
        p[frame_set.first_motion - 1] = 0.0
    columns = []
    parts = _parts_of_cycle(window)
    for part in parts:
        changed = [*frame_set.windows[:index], part, *frame_set.windows[index + 1 :]]
        shown, _ = replace(frame_set, windows=changed).forward_model(transfer_factory, reach)(p)
        columns.append((shown - base)[rows] * _share(window, len(parts), correction))
    return np.stack(columns)


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


def find_light_fault(
    scores: Sequence[LightScore], probability: float = LIGHT.light_mismatch_probability
) -> LightFault | None:
    """How targets that saw the same light together contradict its code; None where they do not.

    Single targets with a wrong fit do not speak for all: without those that contradict it most, the others must, too.

    Parameters
    ----------
    scores
        Of the targets of a frame, or of the frames that several cameras took of it, for the same code.
    probability
        Of what is seen, the code being played, below which it was not.
    """
    gain = LIGHT.constant_light_gain
    if sum(max(one.constant_excess, -gain) for one in scores) <= -gain:
        return LightFault(is_constant=True)
    if not scores:
        return None
    common = _common_correction(scores)
    if common.probability > probability:
        return None
    # What no standard deviation would show needs no flag: lamps fade and warm up a little.
    if _effect_sd(scores, common) < LIGHT.least_light_effect_sd:
        return None
    others = _common_correction(_without_worst(scores, [_own_chi2(one) for one in scores]))
    agree = others.cost > LIGHT.least_agreement * common.cost and others.probability < LIGHT.agreement_probability
    return LightFault(is_constant=False, rms=common.rms) if agree else None


@dataclass(frozen=True, slots=True, eq=False)
class _CommonCorrection:
    """The brightness of the parts of the cycle that targets ask for together.

    Attributes
    ----------
    correction, covariance
        (n,) and (n, n) along what the images show; 0 along the rest.
    cost, probability
        Squared standard deviations of the correction, and the probability of more, the code being played.
    """

    correction: FloatArray
    covariance: FloatArray
    cost: float
    probability: float

    @property
    def rms(self) -> float:
        """Root mean square of the correction."""
        return float(np.sqrt(np.mean(self.correction**2)))


def _common_correction(scores: Sequence[LightScore]) -> _CommonCorrection:
    """The correction by least squares."""
    information = np.sum([one.information for one in scores], axis=0)
    score = np.sum([one.score for one in scores], axis=0)
    values, vectors = np.linalg.eigh(information)
    # All parts brighter, or the code turned with all phases, is not seen at all.
    seen = values > LIGHT.light_correction_sd**-2
    values, vectors = values[seen], vectors[:, seen]
    along = vectors.T @ score
    cost = float(np.sum(along**2 / values))
    probability = float(chi2.sf(cost, len(values))) if len(values) else 1.0
    return _CommonCorrection(vectors @ (along / values), (vectors / values) @ vectors.T, cost, probability)


def _effect_sd(scores: Sequence[LightScore], common: _CommonCorrection) -> float:
    """Root mean square error of the targets' motions by the correction, in their standard deviations."""
    squares = []
    for one in scores:
        if one.response_sd is None:
            return math.inf
        noise = float(np.sum((one.response_sd @ common.covariance) * one.response_sd))
        squares.append((float(np.sum((one.response_sd @ common.correction) ** 2)) - noise) / len(one.response_sd))
    return math.sqrt(max(float(np.mean(squares)), 0.0))


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


def _share(window: ExposureWindow, count: int, correction: float) -> float:
    """Light of one part of the cycle at full brightness over all light."""
    light, parts = window.light, light_parts(window, 0.0)
    assert light is not None
    room = max((light.ambient + correction) * parts.room_cycles, -0.9 * parts.lamp_cycles)
    return light.cycles / count / (parts.lamp_cycles + room)
