"""Ambient light that the targets of a frame share: each one's estimate of it sharpens that of all others.

Each fit under coded light has a correction δ of the stated ambient light, with the prior N(0, σ²). The room's light is
common to the frame, and so is δ. A fit states its posterior mean δᵢ, its variance vᵢ and its covariance cᵢ with the
motion, so that the information of the image alone is wᵢ = 1/vᵢ − 1/σ², at the value mᵢ = δᵢ/(vᵢ wᵢ). What all other
targets know replaces the prior of each one: N(d, s²) with

    s² = τ² + 1/(1/σ² + Σ 1/(1/wⱼ + τ²)),

in which τ² is the scatter of δ between places beyond its noise: room light over lamp light varies over a structure (
DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2). In linear terms nothing has to be fitted again:

    θ' = θ + cᵢ/vᵢ (δ' − δᵢ),     C' = C − cᵢcᵢᵀ/vᵢ + cᵢcᵢᵀ v'/vᵢ²,     1/v' = wᵢ + 1/s²,  δ' = v'(wᵢmᵢ + d/s²).

A twin that asks for another ambient light than the frame's loses likelihood by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from labdaemon.blur.candidate_order import led_by_best, own_motion
from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion, AmbientEstimate, ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import FloatArray


@dataclass(frozen=True, slots=True)
class _FramePrior:
    """What other targets know of the correction: mean and variance."""

    mean: float
    variance: float


def share_ambient(measured: Sequence[Measurement]) -> list[Measurement]:
    """All targets of a frame, or of a group of frames, with the ambient light that they share.

    Parameters
    ----------
    measured
        Of one camera. Those without an `ambient` estimate stay as they are.

    Returns
    -------
    list of Measurement
        In the same order. The more likely one of a target's candidates leads, and `Flag.AMBIGUOUS` follows.
    """
    estimates = {index: one.ambient for index, one in enumerate(measured) if one.ambient is not None and not one.flags}
    result = list(measured)
    for index, one in enumerate(measured):
        if one.ambient is None:
            continue
        others = [estimate for place, estimate in estimates.items() if place != index and _precision(estimate) > 0]
        if len(others) >= LIGHT.min_ambient_targets:
            result[index] = _with_known(one, _combine(others))
    return result


@dataclass(frozen=True, slots=True)
class CommonAmbient:
    """What the images of a frame's targets say of the ambient light, without what was stated of it.

    Attributes
    ----------
    correction, sd
        Of the stated ambient light, in parts of the lamp's full brightness; the scatter between places is in it.
    scatter
        Standard deviation between places beyond the noise.
    """

    correction: float
    sd: float
    scatter: float = 0.0

    @property
    def is_uniform(self) -> bool:
        """Whether all targets ask for nearly the same correction, as they do where ambient light is to blame."""
        return self.scatter < LIGHT.max_ambient_scatter * abs(self.correction)

    def contradicts(self, stated_sd: float) -> bool:
        """Whether it and what was stated exclude each other."""
        return abs(self.correction) > LIGHT.ambient_contradiction_sd * float(np.hypot(self.sd, stated_sd))


def free_ambient(window: ExposureWindow) -> ExposureWindow:
    """The exposure with ambient light of which next to nothing is known."""
    light = window.light
    if light is None:
        return window
    return replace(window, light=replace(light, sd_ambient=max(light.sd_ambient, LIGHT.free_ambient_sd)))


def estimate_common_ambient(measured: Sequence[Measurement]) -> CommonAmbient | None:
    """The ambient light by all targets of a frame, or of a group of frames; None where no image shows it.

    Parameters
    ----------
    measured
        Of one camera, before `share_ambient`.
    """
    estimates = [one.ambient for one in measured if one.ambient is not None and not one.flags]
    estimates = [one for one in estimates if _precision(one) > 0]
    if not estimates:
        return None
    weight = np.array([_precision(one) for one in estimates])
    value = np.array([_image_value(one) for one in estimates])
    scatter = _scatter_between(value, weight) if len(value) > 1 else 0.0
    weight = 1 / (1 / weight + scatter)
    return CommonAmbient(float(weight @ value / weight.sum()), float(weight.sum() ** -0.5), float(np.sqrt(scatter)))


def _precision(estimate: AmbientEstimate) -> float:
    """Information of one image on the correction; 0 where it is no more than rounding."""
    own = 1 / estimate.variance - 1 / estimate.prior_variance
    return own if own > LIGHT.least_ambient_share / estimate.prior_variance else 0.0


def _image_value(estimate: AmbientEstimate) -> float:
    """The correction that the image alone asks for."""
    return estimate.correction / (estimate.variance * _precision(estimate))


def _combine(estimates: Sequence[AmbientEstimate]) -> _FramePrior:
    """What the targets together know of the correction at another place of the frame."""
    weight = np.array([_precision(one) for one in estimates])
    value = np.array([_image_value(one) for one in estimates])
    scatter = _scatter_between(value, weight)
    weight = 1 / (1 / weight + scatter)
    total = 1 / estimates[0].prior_variance + float(weight.sum())
    return _FramePrior(float(weight @ value) / total, scatter + 1 / total)


def _scatter_between(value: FloatArray, weight: FloatArray) -> float:
    """Variance of the correction between targets beyond their noise; 0 where noise explains the differences."""
    squares = float(weight @ (value - weight @ value / weight.sum()) ** 2)
    freedom = len(value) - 1
    if squares < chi2.isf(LIGHT.ambient_scatter_probability, freedom):
        return 0.0
    return (squares - freedom) / float(weight.sum() - weight @ weight / weight.sum())


def _with_known(one: Measurement, known: _FramePrior) -> Measurement:
    """One target, its candidates weighed anew by the frame's ambient light."""
    return led_by_best(one, [_updated(candidate, known) for candidate in (own_motion(one), *one.alternatives)])


def _updated(candidate: AlternativeMotion, known: _FramePrior) -> AlternativeMotion:
    """A candidate under the ambient light that other targets know."""
    estimate = candidate.ambient
    if estimate is None:
        return candidate
    weight, prior = _precision(estimate), estimate.prior_variance
    value = _image_value(estimate) if weight > 0 else 0.0
    variance = 1 / (weight + 1 / known.variance)
    correction = variance * (weight * value + known.mean / known.variance)
    gain = estimate.cross_px / estimate.variance
    step = gain * (correction - estimate.correction)
    covariance = candidate.covariance_px2 + np.outer(gain, gain) * (variance - estimate.variance)
    excess = candidate.excess
    if weight > 0:
        excess += (value - known.mean) ** 2 / (1 / weight + known.variance) - value**2 / (1 / weight + prior)
    return AlternativeMotion(
        candidate.centre_px + step[:2],
        candidate.a_px + step[2:4],
        candidate.b_px + step[4:],
        covariance,
        excess,
        AmbientEstimate(correction, variance, gain * variance, known.variance),
    )
