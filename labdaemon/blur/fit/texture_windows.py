"""Textured patches through windows and under coded light: what is asked before their motion is fitted by its vectors.

Whether anything moves, and in which directions the texture shows it, is seen by the second moment of the motion, as
over whole cycles: at rest the window plays no part, and the moment's equations have a slope there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.average import average_measurements
from labdaemon.blur.fit.direct import fit_orbit
from labdaemon.blur.fit.texture import measure_texture
from labdaemon.blur.motion import Defocus, ExposureWindow, Measurement, empty_measurement, with_relative_sd
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.smear.texture_frames import with_clean_texture
from labdaemon.blur.waveform import window_nodes
from labdaemon.flags import Flag
from labdaemon.orbit_axes import moment_matrix, second_moment


def measure_still_texture(
    sharp: SharpTarget, problems: Sequence[FitProblem], windows: Sequence[ExposureWindow], blurs: Sequence[Defocus]
) -> Measurement | FrameSet:
    """What frames of a textured patch show without a fit of vectors; where such a fit is to be made, and for dots, its
    frames, with what the second moments say of place and motion to begin with.

    Parameters
    ----------
    sharp, problems, windows, blurs
        The target and its frames.

    Returns
    -------
    Measurement or FrameSet
        At rest, with its limit; without texture, `not_found`; with structure in one direction only, `undetermined`:
        under constant light the amplitude that shows, with the error of the unknown phase in its sd, under coded light
        no numbers.
    """
    form = sharp.form
    if not isinstance(form, TexturedPatch):
        return FrameSet.from_problems(sharp, list(problems), windows, blurs)
    found = [
        measure_texture(
            sharp, form, problem, blur, fit_orbit(sharp, problem, blur).solution, orbit=True, flags=set[Flag]()
        )
        for problem, blur in zip(problems, blurs, strict=True)
    ]
    flags = set[Flag]().union(*(one.flags for one in found))
    if Flag.NOT_FOUND in flags:
        return empty_measurement(sharp.name, flags - {Flag.AT_REST})
    if Flag.UNDETERMINED in flags:
        if any(window.is_coded for window in windows):
            return empty_measurement(sharp.name, {Flag.NOT_FOUND, Flag.UNDETERMINED})
        scale, spread = _whole_cycle_ratio(windows)
        mean = average_measurements(found)
        scaled = replace(
            mean, a_px=scale * mean.a_px, b_px=scale * mean.b_px, covariance_px2=_scaled(mean.covariance_px2, scale)
        )
        return with_relative_sd(scaled, spread)
    if all(Flag.AT_REST in one.flags for one in found):
        return average_measurements(found)
    begun = [
        replace(problem, initial_centre_px=one.centre_px.copy()) for problem, one in zip(problems, found, strict=True)
    ]
    moments = [moment_matrix(second_moment(one.a_px, one.b_px)) for one in found]
    frame_set = with_clean_texture(FrameSet.from_problems(sharp, begun, windows, blurs))
    return replace(frame_set, moment_px2=np.mean(moments, axis=0))


def _whole_cycle_ratio(windows: Sequence[ExposureWindow]) -> tuple[float, float]:
    """Amplitude over that which a model of whole cycles reads, mean over the motion's phase, and its relative sd."""
    phases = np.pi * np.arange(24) / 24
    variance = np.zeros(len(phases))
    for window in windows:
        basis, weight = window_nodes(window, 3.0)
        course = np.stack((np.cos(phases), np.sin(phases)), axis=1) @ basis
        variance += (course**2 @ weight - (course @ weight) ** 2) / len(windows)
    ratio = np.sqrt(0.5 / np.maximum(variance, 0.05))
    return float(np.mean(ratio)), float(np.std(ratio) / np.mean(ratio))


def _scaled(covariance: FloatArray, scale: float) -> FloatArray:
    """(6, 6) covariance of x, y, a, b after a and b were multiplied."""
    by = np.array([1.0, 1.0, scale, scale, scale, scale])
    result: FloatArray = covariance * np.outer(by, by)
    return result
