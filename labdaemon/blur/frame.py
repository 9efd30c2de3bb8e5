"""All targets of one frame, with the defocus that they share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, Measurement, match_guesses
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.defocus import estimate_target_defocus, with_anisotropy
from labdaemon.blur.waveform import MotionWaveform


def measure_frame(
    sharps: Sequence[SharpTarget],
    patches: Sequence[Patch],
    *,
    window: ExposureWindow | None = None,
    defocus: Defocus | None = None,
    initial_guesses: Sequence[InitialGuess | None] | None = None,
    orbit: bool = True,
    waveform: MotionWaveform | None = None,
    camera_shift_px: FloatArray | None = None,
    harmonics: Sequence[MotionHarmonics | None] | None = None,
) -> list[Measurement]:
    """Measure the targets of one frame.

    Parameters
    ----------
    sharps, patches
        Target and its part of the blurred frame, one by one.
    defocus
        From `estimate_frame_defocus` over the control targets. None estimates it from the targets themselves, in a
        first pass in which each dot has its own.
    initial_guesses
        One a target, or none.
    window, orbit, waveform, camera_shift_px
        As for `measure`.
    harmonics
        Of each target's motion, None where none are known.

    Returns
    -------
    list of Measurement
        In the order given.

    Raises
    ------
    UsageError
        Sequences of different lengths.
    """
    guesses = match_guesses(sharps, patches, initial_guesses)

    def one(index: int, blur: Defocus | None, *, curved: bool) -> Measurement:
        return measure(
            sharps[index],
            patches[index],
            window=window,
            defocus=blur,
            initial_guess=guesses[index],
            orbit=curved,
            waveform=waveform,
            camera_shift_px=camera_shift_px,
            harmonics=None if harmonics is None else harmonics[index],
        )

    dots = [index for index, sharp in enumerate(sharps) if not isinstance(sharp.form, TexturedPatch)]
    shared: Sequence[Defocus | None] = [defocus] * len(dots)
    if defocus is None:
        # Straight paths: across its path a straight motion leaves the defocus alone to be seen.
        estimated = estimate_target_defocus([one(index, None, curved=False) for index in dots])
        shared = [None] * len(dots) if estimated is None else with_anisotropy(estimated, [sharps[k] for k in dots])
    blurs: list[Defocus | None] = [defocus] * len(sharps)
    for index, blur in zip(dots, shared, strict=True):
        blurs[index] = blur
    return [one(index, blur, curved=orbit) for index, blur in enumerate(blurs)]


def measure_displacement(sharp: SharpTarget, later: SharpTarget) -> tuple[FloatArray, FloatArray]:
    """Static displacement of a target between two sharp sets.

    Returns
    -------
    shift, covariance
        (2,) px and (2, 2) px²; NaN where either could not be fitted.
    """
    if not (sharp.usable and later.usable):
        return np.full(2, np.nan), np.full((2, 2), np.nan)
    return later.centre_px - sharp.centre_px, later.covariance_px2 + sharp.covariance_px2
