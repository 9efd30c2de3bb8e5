"""Time-reversed solutions: frames of one part of the cycle do not separate a motion from its time reversal.

An image keeps no order of time. Run backwards from the middle of an exposure, the same path leaves the same smear:
with μ the excitation's phase there, M = a·sin μ + b·cos μ the displacement and W = a·cos μ − b·sin μ the change,
W → −W. Frames whose middles lie at the same phase, or half a cycle apart, all have the same image, and nothing but
another phase decides between the two.
"""

from __future__ import annotations

import numpy as np

from labdaemon.blur.light_code import mirror_axes
from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import PHASE
from labdaemon.blur.smear.frame_set import FrameSet


def mid_exposure_phase(frame_set: FrameSet, frame: int = 0) -> float:
    """Excitation phase at the middle of an exposure, an unknown opening phase counting as 0."""
    window = frame_set.windows[frame]
    return (window.phase_rad or 0.0) + np.pi * window.cycles


def reverse_time(a: FloatArray, b: FloatArray, middle_rad: float) -> tuple[FloatArray, FloatArray]:
    """Vectors a and b of the motion run backwards from a phase, each (2,)."""
    c, s = np.cos(middle_rad), np.sin(middle_rad)
    there, change = a * s + b * c, a * c - b * s
    return there * s - change * c, there * c + change * s


def time_reversed_solutions(frame_set: FrameSet, a: FloatArray, b: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """The mirror images of a motion in its frames, that differ from it and from each other."""
    middles: list[float] = []
    for frame, window in enumerate(frame_set.windows):
        # Coded light has its twins about the axes of the code; they are exact only for a symmetric code.
        if window.is_coded and window.light is not None:
            axes = mirror_axes(window.light, least_likeness=0.0)[: LIGHT.code_axes]
        else:
            axes = [mid_exposure_phase(frame_set, frame)]
        for middle in axes:
            if all(abs(np.sin(middle - one)) > PHASE.same_middle_rad for one in middles):
                middles.append(middle)
    pairs = [reverse_time(a, b, middle) for middle in middles]
    return [pair for pair in pairs if differ(a, b, *pair)]


def wrap_angle(angle_rad: float) -> float:
    """The angle within half a turn of 0."""
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def differ(a: FloatArray, b: FloatArray, other_a: FloatArray, other_b: FloatArray) -> bool:
    """Whether two motions differ by more than rounding and noise."""
    away = np.concatenate((other_a - a, other_b - b))
    return float(np.linalg.norm(away)) > PHASE.same_motion_fraction * float(np.linalg.norm(np.concatenate((a, b))))
