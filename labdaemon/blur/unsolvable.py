"""What becomes of a target whose equations have no solution: a flag for that target, and the others are measured.

A screen over the dot, a moiré, paper in clipped white: the normal matrix is then singular, or the path runs away.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import numpy as np

from labdaemon.blur.motion import Measurement, empty_measurement
from labdaemon.blur.patch.pixels import Patch
from labdaemon.flags import Flag

UNSOLVABLE = (np.linalg.LinAlgError, FloatingPointError, MemoryError)
"""What NumPy raises where there is no solution. A `MemoryError` comes from a path of absurd length."""


class NamedTarget(Protocol):
    """A target that has a name."""

    @property
    def name(self) -> str:
        """The target's name."""
        ...


Target = TypeVar("Target", bound=NamedTarget)
Data = TypeVar("Data", Patch, Sequence[Patch])
P = ParamSpec("P")
R = TypeVar("R")
Measure = Callable[Concatenate[Target, Data, P], Measurement]


def solved(function: Callable[P, R]) -> Callable[P, R | None]:
    """Make a function return None where its equations have no solution."""

    @wraps(function)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R | None:
        try:
            with np.errstate(divide="raise", over="raise", invalid="raise"):
                return function(*args, **kwargs)
        except UNSOLVABLE:  # the caller reports a target without numbers
            return None

    return guarded


def flag_unsolvable(measure: Measure[Target, Data, P]) -> Measure[Target, Data, P]:
    """Make a function that measures one target report `poor_fit` and no numbers where it has no solution.

    Parameters
    ----------
    measure
        Takes a target and its patch, or its patches in several frames.

    Returns
    -------
    The same function. An overflow, a division by zero or an invalid value of NumPy counts as no solution, as does a
    path that is longer than the patches.
    """

    @wraps(measure)
    def guarded(target: Target, data: Data, /, *args: P.args, **kwargs: P.kwargs) -> Measurement:
        found = solved(measure)(target, data, *args, **kwargs)
        return empty_measurement(target.name, {Flag.POOR_FIT}) if found is None or _is_absurd(found, data) else found

    return guarded


def _is_absurd(found: Measurement, data: Patch | Sequence[Patch]) -> bool:
    """Whether a path is longer than every patch that it was seen in."""
    patches = [data] if isinstance(data, Patch) else data
    side = max((max(patch.shape) for patch in patches), default=0)
    return bool(np.hypot(*found.a_px) > side or np.hypot(*found.b_px) > side)
