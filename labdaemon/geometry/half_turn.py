"""Phases of motions within half a turn: v and −v are one axis, and so are phases half a turn apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def within_half_turn(angle_rad: FloatArray) -> FloatArray:
    """Angles within a quarter turn of 0, half a turn being nothing."""
    result: FloatArray = (angle_rad + np.pi / 2) % np.pi - np.pi / 2
    return result


def axis_phase(a: FloatArray, b: FloatArray) -> float:
    """Phase ψ of a motion v·sin(ωt + ψ), or of an orbit's major axis, by its signed vectors a and b."""
    return float(np.angle(np.sum((a + 1j * b) ** 2)) / 2)
