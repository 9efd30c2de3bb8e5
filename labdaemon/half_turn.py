"""Phases and directions within half a turn: v and −v are one axis, and so are phases half a turn apart."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Angle = TypeVar("Angle", float, FloatArray)


def within_half_turn(angle_rad: Angle) -> Angle:
    """Angles within a quarter turn of 0, half a turn being nothing."""
    return (angle_rad + np.pi / 2) % np.pi - np.pi / 2


def major_phase_rad(a: FloatArray, b: FloatArray) -> float:
    """Phase ψ of an orbit's major axis: a sin θ + b cos θ is largest along it as sin(θ + ψ)."""
    return 0.5 * math.atan2(2.0 * float(a @ b), float(a @ a - b @ b))
