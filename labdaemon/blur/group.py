"""Captures of one steady motion at several opening phases, measured together: signed vectors a and b."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.measure import WHOLE, measure
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, Window, nothing
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.phase.known_window import unphased
from labdaemon.blur.phase.steady import Steady, fit_steady
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.defocus import default_blur
from labdaemon.blur.smear.honesty import reach_flags
from labdaemon.blur.smear.model import Setting, prepare
from labdaemon.blur.smear.windowed import FRAME, Exposures
from labdaemon.errors import UsageError
from labdaemon.flags import Flag


def measure_group(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[Window],
    *,
    extra_blur: Sequence[ExtraBlur] | ExtraBlur | None = None,
    starts: Sequence[Start] | None = None,
) -> Measurement:
    """Measure one steady motion from several frames opened at known phases.

    The mean position is free in each frame (a tenth of a pixel of drift would turn into tens of degrees); a, b and the
    target's shape are common. Timing uncertainty of each window enters the covariance.

    Parameters
    ----------
    sharp
        The target at rest.
    patches, windows
        One a frame; every window with its phase.
    extra_blur
        Of each frame, or one for all.
    starts
        Expected place in each frame.

    Returns
    -------
    Measurement
        `phased` is True; the centre is the mean over frames. Whole cycles hold no phase: then it is False, and a and b
        are the orbit's axes. With a single frame, or several that see the same part of
        the cycle, mirrored solutions fit alike: then `Flag.AMBIGUOUS` is set.

    Raises
    ------
    UsageError
        Not one window a patch, or a window without phase.
    """
    count = len(patches)
    if count == 0 or len(windows) != count or (starts is not None and len(starts) != count):
        raise UsageError("a group needs one window (and one start, if any) for each frame")
    if any(window.phase_rad is None for window in windows):
        raise UsageError("every frame of a group needs its opening phase (phase_rad in capture.toml)")
    if not sharp.usable:
        return nothing(sharp.name, {Flag.NOT_FOUND})
    if all(abs(window.cycles - round(window.cycles)) < WHOLE for window in windows):
        return _without_phase(sharp, patches, windows, extra_blur, starts)
    blurs = [extra_blur or default_blur(sharp)] * count if not isinstance(extra_blur, Sequence) else list(extra_blur)
    settings: list[Setting] = []
    for index, patch in enumerate(patches):
        expected = starts[index].centre_px if starts is not None else sharp.centre_px
        setting = prepare(sharp, patch, np.asarray(expected, dtype=np.float64))
        if setting is None:
            return nothing(sharp.name, {Flag.NOT_FOUND})
        settings.append(setting)
    there = np.mean([setting.start_px for setting in settings], axis=0)
    exposures = Exposures.of(sharp.elsewhere(there), settings, windows, blurs)
    return _report(exposures, fit_steady(exposures))


def _without_phase(
    sharp: SharpTarget,
    patches: Sequence[Patch],
    windows: Sequence[Window],
    extra_blur: Sequence[ExtraBlur] | ExtraBlur | None,
    starts: Sequence[Start] | None,
) -> Measurement:
    """Whole cycles look the same from whatever phase they are opened at: the frames' mean, unphased."""
    single = [
        measure(
            sharp,
            patch,
            window=windows[index],
            extra_blur=extra_blur[index] if isinstance(extra_blur, Sequence) else extra_blur,
            start=None if starts is None else starts[index],
        )
        for index, patch in enumerate(patches)
    ]
    seen = [one for one in single if np.all(np.isfinite(one.a_px))]
    if not seen:
        return single[0]
    reference = max(seen, key=lambda one: float(np.hypot(*one.a_px)))

    def vector(one: Measurement) -> FloatArray:
        a = one.a_px if float(one.a_px @ reference.a_px) >= 0 else -one.a_px
        b = one.b_px if float(one.b_px @ reference.b_px) >= 0 else -one.b_px
        return np.concatenate((one.centre_px, a, b))

    weight = np.array([1 / max(float(np.trace(one.covariance_px2[2:4, 2:4])), 1e-12) for one in seen])
    weight /= weight.sum()
    value = np.sum([w * vector(one) for w, one in zip(weight, seen, strict=True)], axis=0)
    covariance = np.sum([w**2 * one.covariance_px2 for w, one in zip(weight, seen, strict=True)], axis=0)
    flags = {flag for one in single for flag in one.flags}
    if not all(Flag.AT_REST in one.flags for one in single):
        flags.discard(Flag.AT_REST)
    blur = float(weight @ np.array([one.extra_blur_px2 for one in seen]))
    chi2 = float(weight @ np.array([one.chi2 for one in seen]))
    return Measurement(sharp.name, value[:2], value[2:4], value[4:], covariance, False, frozenset(flags), blur, chi2)


def _report(exposures: Exposures, found: Steady) -> Measurement:
    sharp, best, value, cov = exposures.sharp, found.solution, found.value, found.covariance
    flags = set(reach_flags(sharp, best, value[2:4], value[4:6]))
    if found.at_rest:
        flags.add(Flag.AT_REST)
    elif found.rival:
        flags.add(Flag.AMBIGUOUS)
    blur = float(np.mean(best.p[2 : FRAME * len(exposures.settings) : FRAME]))
    axes = unphased(sharp, found) if found.is_loose else None
    return Measurement(
        sharp.name, value[:2], value[2:4], value[4:6], cov, True, frozenset(flags), blur, best.chi2, axes
    )
