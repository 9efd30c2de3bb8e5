"""A frame's own motion: the shift, rotation and defocus of its control targets against the sharp frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur import (
    Defocus,
    FloatArray,
    InitialGuess,
    Patch,
    StaticMeasurement,
    estimate_frame_defocus,
    measure_static,
    solved,
)
from labdaemon.errors import DataError
from labdaemon.imaging import RawFrame
from labdaemon.processing.control import ControlTargets, read_control_places
from labdaemon.processing.matched_filter import GreyLike
from labdaemon.processing.thumbnails import find_thumbnail

REACH_PX = 24
"""Largest shift that is found without reading the codes again."""
LEAST_SCORE = 0.8
"""Correlation below which a control target is not at the searched place."""
SD_BETWEEN_PX2 = 0.04
"""Variance of the extra blur that a control target gives in a frame shifted by half a pixel: its samples then are
interpolated from a mosaic, which costs sharpness of its own. Nothing is lost at whole pixels."""
SD_TURN_PX = 1.0
"""Prior standard deviation of a frame's rotation times its width, px: mirrors shift, they hardly turn."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameShift:
    """Shift, rotation and defocus of a frame, by its control targets.

    Attributes
    ----------
    stills
        Those that were measured.
    shift_px, middle_px, turn_rad
        A point p moved by `shift_px` + `turn_rad` × (p − `middle_px`).
    defocus
        Isotropic extra blur; None where no control target measures it.
    """

    stills: tuple[StaticMeasurement, ...]
    shift_px: FloatArray
    middle_px: FloatArray
    turn_rad: float
    defocus: Defocus | None

    def at(self, points_px: FloatArray) -> FloatArray:
        """(n, 2) shift of (n, 2) points of the sharp frame."""
        away = points_px - self.middle_px
        turned = np.column_stack([-away[:, 1], away[:, 0]])
        result: FloatArray = self.shift_px + self.turn_rad * turned
        return result


UNKNOWN = FrameShift((), np.zeros(2), np.zeros(2), 0.0, None)


def frame_shift(frame: RawFrame, grey: GreyLike, control: ControlTargets) -> FrameShift:
    """Measure the control targets of a frame against the sharp one.

    Parameters
    ----------
    frame, grey
        The later frame.
    control
        What the sharp frame showed.
    """
    if not control.names:
        return UNKNOWN
    starts = _initial_places(frame, grey, control)
    stills = []
    for target, start in zip(control.sharp, starts, strict=True):
        if start is None:
            continue
        patch = _cut_target(frame, target.form.half_size_px, start)
        still = solved(measure_static)(target, patch, initial_guess=InitialGuess(start))
        if still is None:
            continue
        if np.isfinite(still.covariance_px2).all() and np.isfinite([*still.shift_px, still.defocus_px2]).all():
            stills.append(still)
    if not stills:
        return UNKNOWN
    return _fit(stills, frame.size)


def _cut_target(frame: RawFrame, half_size: tuple[float, float], centre: FloatArray) -> Patch:
    half_w, half_h = (int(np.ceil(v)) + 4 for v in half_size)
    x, y = (round(float(v)) for v in centre)
    return frame.patch(x - half_w, y - half_h, 2 * half_w + 1, 2 * half_h + 1)


def _initial_places(frame: RawFrame, grey: GreyLike, control: ControlTargets) -> list[FloatArray | None]:
    """Rough place of each control target's thumbnail in the frame."""
    found = [find_thumbnail(grey, thumbnail, REACH_PX) for thumbnail in control.thumbnails]
    centres = [target.centre_px for target in control.sharp]
    good = [score >= LEAST_SCORE for _, score in found]
    if sum(good) >= max(2, len(found) / 2):
        return [c + shift if ok else None for c, (shift, _), ok in zip(centres, found, good, strict=True)]
    places = read_control_places(frame, control.family)
    return [
        c + places[name] - tag if name in places else (c + shift if ok else None)
        for name, c, tag, (shift, _), ok in zip(control.names, centres, control.centres_px, found, good, strict=True)
    ]


def _fit(stills: Sequence[StaticMeasurement], size: tuple[int, int]) -> FrameShift:
    """Shift and turn by robust least squares, the turn held near zero where targets are few."""
    centres = np.array([still.centre_px for still in stills])
    shifts = np.array([still.shift_px for still in stills])
    sd = np.sqrt(np.array([np.trace(still.covariance_px2[:2, :2]) / 2 for still in stills]) + 0.01**2)
    middle = centres.mean(axis=0)
    away = centres - middle
    design = np.zeros((len(stills), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -away[:, 1], away[:, 0]
    weight = 1 / sd**2
    p = np.append(np.median(shifts, axis=0), 0.0)
    prior = np.diag([0.0, 0.0, (size[0] / SD_TURN_PX) ** 2])
    for _ in range(10):
        miss = np.hypot(*(shifts - design @ p).T) / sd
        spread = max(1.0, 1.2 * float(np.median(miss)))
        w = weight * np.minimum(1.0, 2.0 * spread / np.maximum(miss, 1e-12))
        normal = np.einsum("n,nij,nik->jk", w, design, design) + prior
        p = np.linalg.solve(normal, np.einsum("n,nij,ni->j", w, design, shifts))
    try:
        blur = estimate_frame_defocus(stills)
    except DataError:
        blur = None
    if blur is not None:
        between = np.abs(p[:2] - np.rint(p[:2])).max()
        blur = replace(blur, sd_px2=float(np.hypot(blur.sd_px2, 2 * between * SD_BETWEEN_PX2)))
    return FrameShift(tuple(stills), p[:2], middle, float(p[2]), blur)
