"""The extra blur of a frame: assumed, from control targets, or from the moving targets themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.defocus_settings import DEFOCUS
from labdaemon.blur.motion import Defocus, Measurement, StaticMeasurement
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.target import EllipseShape, SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.least_squares import huber_weight


def default_defocus(sharp: SharpTarget) -> Defocus:
    """Prior for the defocus without any control target."""
    return Defocus(0.0, DEFOCUS.patch_sd_px2 if isinstance(sharp.form, TexturedPatch) else DEFOCUS.dot_sd_px2)


def estimate_frame_defocus(stills: Sequence[StaticMeasurement]) -> Defocus:
    """A frame's extra blur against the sharp frame: a robust weighted mean over its control targets.

    Parameters
    ----------
    stills
        One for each control target; those without numbers are left out.

    Returns
    -------
    Defocus
        Its standard deviation is the larger of the formal one and the scatter's.

    Raises
    ------
    DataError
        None of them could be measured.
    """
    seen = [s for s in stills if np.isfinite(s.defocus_px2) and s.covariance_px2[2, 2] > 0]
    if not seen:
        raise DataError("no control target could be measured in this frame; check that they are in view and lit")
    value = np.array([s.defocus_px2 for s in seen])
    mean, sd, _ = _robust_mean(value, np.array([s.covariance_px2[2, 2] for s in seen]) + 1e-6)
    return Defocus(mean, float(np.hypot(sd, DEFOCUS.common_error_sd_px2)))


def estimate_target_defocus(measurements: Sequence[Measurement]) -> Defocus | None:
    """A frame's extra blur from targets that were each fitted with their own; None if there are fewer than three.

    It is known no better than it scatters from target to target, and as far as it goes it may be one-sided.
    """
    lost = {Flag.NOT_FOUND, Flag.SATURATED, Flag.OCCLUDED}
    seen = [m.defocus_px2 for m in measurements if not (m.flags & lost) and np.isfinite(m.defocus_px2)]
    if len(seen) < 3:
        return None
    value = np.array(seen)
    mean, _, scatter = _robust_mean(value, np.full(len(value), max(float(np.var(value)), 1e-6)))
    scatter = max(scatter, DEFOCUS.min_scatter_px2)
    return Defocus(mean, scatter, 2 * float(np.hypot(mean, scatter)))


def with_anisotropy(shared: Defocus, sharps: Sequence[SharpTarget]) -> list[Defocus]:
    """A frame's extra blur with what its anisotropy may add to each target's squared amplitude.

    A change of focus by δ adds m = kδ² to the variance of a dot in focus, but up to m + 2·sqrt(m·e) to one whose own
    defocus is e already. An astigmatic lens does not defocus equally along both axes.

    Parameters
    ----------
    shared
        From `estimate_target_defocus`.
    sharps
        Targets of the frame; their defocus is counted from the sharpest of the dots.

    Returns
    -------
    list of Defocus
        One for each target.
    """
    blur = np.array([_lens_variance(sharp) for sharp in sharps])
    known = np.isfinite(blur)
    own = np.where(known, blur - (np.min(blur[known]) if known.any() else 0.0), 0.0)
    seen = max(abs(shared.mean_px2) - shared.sd_px2, 0.0)
    first_order = 4 * np.sqrt(seen * own)
    sd = DEFOCUS.anisotropy_fraction * np.hypot(shared.anisotropy_px2, first_order)
    return [replace(shared, sd_anisotropy_px2=float(one)) for one in sd]


def _lens_variance(sharp: SharpTarget) -> float:
    """Lens blur of a dot, px²; NaN where it is not known."""
    if not (sharp.usable and isinstance(sharp.form, EllipseShape)):
        return float("nan")
    return sharp.form.lens.equivalent_variance_px2(DEFOCUS.sharpness_frequency)


def _robust_mean(value: FloatArray, variance: FloatArray) -> tuple[float, float, float]:
    """Weighted mean with Huber's weights, its standard deviation, and the scatter (1.48 MAD).

    Huber 1964, doi:10.1214/aoms/1177703732. The scale is that of the deviations themselves, 1 at least.
    """
    mean = float(np.median(value))
    weight = 1 / variance
    for _ in range(10):
        pull = np.abs(value - mean) / np.sqrt(variance)
        spread = max(1.0, 1.48 * float(np.median(pull)))
        weight = huber_weight(pull, 2.0 * spread) / variance
        mean = float(np.sum(weight * value) / np.sum(weight))
    formal = 1 / float(np.sum(1 / variance))
    scatter = float(np.sum(weight**2 * (value - mean) ** 2) / np.sum(weight) ** 2)
    if len(value) > 1:
        scatter *= len(value) / (len(value) - 1)
    mad = 1.48 * float(np.median(np.abs(value - np.median(value))))
    return mean, float(np.sqrt(max(formal, scatter))), mad
