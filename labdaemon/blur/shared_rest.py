"""Places of rest: of two motions that an image may show, one may need a target away from where it was at rest.

A code weighs some parts of the cycle more than others, so that it shifts a target's image, by a third of the amplitude
for the code 1110100. The mean position is a parameter of each fit, and must be: 0.1 px of drift taken for that shift
would be tens of degrees of phase. But a twin, or a phase half a turn off, asks for a mean position that differs from
the place of rest by tenths of a pixel and more, and the targets of a frame say together how far any of them drifts.

With xᵢ the mean positions of the targets that are settled, Vᵢ their covariance, and rᵢ the places of rest in this
frame, the drift of another target is N(m, R): m the median of xᵢ − rᵢ, R their variance beyond Vᵢ by the median
absolute deviation, and no less than sharp frame and camera motion are known to. Each of its candidates (x, V) gets

    −2 log((1 − ε) exp(−q/2) + ε),     q = (x − r − m)ᵀ (V + R)⁻¹ (x − r − m),

where ε stands for targets that drift alone (`labdaemon.rest_place`). Only the choice between valleys and along arcs of
phase is touched: a candidate keeps its mean position, and its motion does not follow the place of rest. A target all of
whose candidates are far from rest, by a part of its motion, is `ambiguous`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.candidate_order import led_by_best, own_motion
from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion, Measurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.phase_arc import mixture_moments, relative_to_best
from labdaemon.flags import Flag
from labdaemon.orbit_axes import orient_positive
from labdaemon.rest_place import RestPlace


def share_rest(measured: Sequence[Measurement], rest_px: FloatArray) -> list[Measurement]:
    """All targets of a frame, or of a group of frames, their candidates weighed by the places of rest.

    Parameters
    ----------
    measured
        Of one camera, signed by the excitation's phase.
    rest_px
        (n, 2) where each would be at rest, the frame's own shift with it.

    Returns
    -------
    list of Measurement
        In the same order. Few settled targets do not show how far targets drift: all then stay as they are.
    """
    settled = [
        index
        for index, one in enumerate(measured)
        if one.phased and not one.flags and one.axes is None and np.isfinite(one.covariance_px2).all()
    ]
    away = {index: measured[index].centre_px - rest_px[index] for index in settled}
    result = list(measured)
    for index, one in enumerate(measured):
        others = [place for place in settled if place != index]
        if len(others) < LIGHT.min_rest_targets or not one.phased or not np.isfinite(one.covariance_px2).all():
            continue
        mean, variance = _drift(
            np.array([away[place] for place in others]),
            np.array([np.diag(measured[place].covariance_px2)[:2] for place in others]),
        )
        rest = RestPlace(rest_px[index] + mean, variance)
        weighed = _weighed(one, rest) if one.arc or one.alternatives else one
        result[index] = _doubted(weighed, rest)
    return result


def _drift(away_px: FloatArray, variance_px2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(2,) mean and (2,) variances of the drift by (n, 2) distances from rest and their (n, 2) variances."""
    mean = np.median(away_px, axis=0)
    scatter = (np.median(np.abs(away_px - mean), axis=0) / LIGHT.median_deviation) ** 2
    return mean, np.maximum(scatter - np.median(variance_px2, axis=0), 0.0) + LIGHT.rest_sd_px**2


def _doubted(one: Measurement, rest: RestPlace) -> Measurement:
    """Flag a motion that is far from rest, by a part of the motion: the true one may not have been found."""
    away = float(np.linalg.norm(one.centre_px - rest.place_px))
    if (
        one.axes is not None
        or Flag.AT_REST in one.flags
        or away < LIGHT.rest_conflict_ratio * one.amplitude_px
        or rest.excess(one.centre_px, one.covariance_px2[:2, :2]) < LIGHT.rest_conflict
    ):
        return one
    return replace(one, flags=one.flags | {Flag.AMBIGUOUS})


def _weighed(one: Measurement, rest: RestPlace) -> Measurement:
    def weigh(candidate: AlternativeMotion) -> AlternativeMotion:
        excess = rest.excess(candidate.centre_px, candidate.covariance_px2[:2, :2])
        return replace(candidate, excess=candidate.excess + excess)

    one = replace(one, rest=rest)
    others = [weigh(candidate) for candidate in one.alternatives]
    if not one.arc or one.axes is None:
        return led_by_best(one, [weigh(own_motion(one)), *others])
    arc = [weigh(candidate) for candidate in one.arc]
    if others and min(other.excess for other in others) < min(part.excess for part in arc) - LIGHT.rival_limit:
        return replace(led_by_best(one, others), axes=None, arc=())
    return _summarised(one, relative_to_best([*arc, *others]))


def _summarised(one: Measurement, arc: Sequence[AlternativeMotion]) -> Measurement:
    """A measurement of which the phase hardly shows, by the motions that are left."""
    assert one.axes is not None
    best = arc[0]
    _, axis, axis_covariance = mixture_moments(arc, np.concatenate((best.centre_px, best.a_px, best.b_px)))
    phasors = np.array([part.a_px @ axis[2:] + 1j * (part.b_px @ axis[2:]) for part in arc])
    phasors /= np.maximum(np.abs(phasors), 1e-12)
    # The mean phase errs less than the most likely one; motions at quite another phase are another valley.
    near = (phasors * np.conj(phasors[0])).real > np.cos(np.pi / 3)
    phase = float(np.angle(near * np.exp([-part.excess / 2 for part in arc]) @ phasors))
    value = np.concatenate((axis[:2], np.cos(phase) * axis[2:], np.sin(phase) * axis[2:]))
    covariance, _, _ = mixture_moments(arc, value)
    positive = orient_positive(axis[2:])
    turn = np.diag([1.0, 1.0, *np.repeat(1.0 if np.array_equal(positive, axis[2:]) else -1.0, 2)])
    axes_covariance = one.axes.covariance_px2.copy()
    axes_covariance[:4, :], axes_covariance[:, :4] = 0.0, 0.0
    axes_covariance[:4, :4] = turn @ axis_covariance @ turn
    axes = replace(one.axes, centre_px=axis[:2], a_px=positive, covariance_px2=axes_covariance)
    return replace(
        one,
        centre_px=value[:2],
        a_px=value[2:4],
        b_px=value[4:],
        covariance_px2=covariance,
        axes=axes,
        alternatives=(),
        arc=tuple(arc),
    )
