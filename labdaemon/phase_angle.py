"""Phases of the excitation as files and messages write them: in [0, 2π)."""

from __future__ import annotations

import math

TURN = 2.0 * math.pi


def wrap_phase(phase_rad: float) -> float:
    """The phase in [0, 2π).

    >>> wrap_phase(-math.pi)
    3.141592653589793
    >>> wrap_phase(-1e-20)
    0.0
    """
    wrapped = phase_rad % TURN
    return wrapped if wrapped < TURN else 0.0  # of a negative number near zero, % is a whole turn
