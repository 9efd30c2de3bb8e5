"""All targets of one frame, with the defocus that they share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.law import DisplacementLaw
from labdaemon.blur.measure import measure
from labdaemon.blur.motion import ExtraBlur, Measurement, Start, Window, starts_for
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.texture import Texture
from labdaemon.blur.smear.defocus import blur_of_targets


def measure_frame(
    sharps: Sequence[SharpTarget],
    patches: Sequence[Patch],
    *,
    window: Window | None = None,
    extra_blur: ExtraBlur | None = None,
    starts: Sequence[Start | None] | None = None,
    orbit: bool = True,
    law: DisplacementLaw | None = None,
    camera_shift_px: FloatArray | None = None,
) -> list[Measurement]:
    """Measure the targets of one frame.

    Parameters
    ----------
    sharps, patches
        Target and its part of the blurred frame, one by one.
    extra_blur
        From `frame_blur` over the control targets. None estimates it from the targets themselves, in a first pass in
        which each dot has its own.
    starts
        One a target, or none.
    window, orbit, law, camera_shift_px
        As for `measure`.

    Returns
    -------
    list of Measurement
        In the order given.

    Raises
    ------
    UsageError
        Sequences of different lengths.
    """
    begin = starts_for(sharps, patches, starts)

    def one(index: int, blur: ExtraBlur | None, *, curved: bool) -> Measurement:
        return measure(
            sharps[index],
            patches[index],
            window=window,
            extra_blur=blur,
            start=begin[index],
            orbit=curved,
            law=law,
            camera_shift_px=camera_shift_px,
        )

    dots = [index for index, sharp in enumerate(sharps) if not isinstance(sharp.form, Texture)]
    shared = extra_blur
    if extra_blur is None:
        # Straight paths: across its path a straight motion leaves the defocus alone to be seen.
        shared = blur_of_targets([one(index, None, curved=False) for index in dots])
    is_dot = set(dots)
    return [one(index, shared if index in is_dot else extra_blur, curved=orbit) for index in range(len(sharps))]


def displacement(sharp: SharpTarget, later: SharpTarget) -> tuple[FloatArray, FloatArray]:
    """Static displacement of a target between two sharp sets.

    Returns
    -------
    shift, covariance
        (2,) px and (2, 2) px²; NaN where either could not be fitted.
    """
    if not (sharp.usable and later.usable):
        return np.full(2, np.nan), np.full((2, 2), np.nan)
    return later.centre_px - sharp.centre_px, later.covariance_px2 + sharp.covariance_px2
