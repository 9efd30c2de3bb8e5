"""Which of a camera's exposure times to use for an excitation.

A shutter should see whole cycles: n cycles and a part bias a whole-cycle model by O(1/n). Two captures at known phases,
on the contrary, tell the sign of a motion only if the blur is skewed, and it is most skewed half a cycle from whole.

Bodies name their steps in rounded figures, but run a ladder of powers of two: in thirds of a stop "1.3 s" is
2^(1/3) = 1.26 s and "1/3 s" is 2^(-5/3) = 0.315 s; in half stops "1.5 s" is 2^(1/2) = 1.41 s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

_LONG_THIRDS_S = (30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3.2, 2.5, 2, 1.6, 1.3)
_BELOW_THIRDS = (
    1, 1.3, 1.6, 2, 2.5, 3, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400, 500,
    640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000,
)  # fmt: skip
_LONG_HALVES_S = (30, 20, 15, 11, 8, 6, 4, 3, 2, 1.5)
_BELOW_HALVES = (
    1, 1.5, 2, 3, 4, 6, 8, 11, 15, 20, 30, 45, 60, 90, 125, 180, 250, 350, 500, 750, 1000, 1500, 2000, 3000, 4000, 6000,
    8000,
)  # fmt: skip
_SAME_NAME = 0.02
"""Relative difference below which two figures are the same name (a body's 0.1 ms units, 0.8 for 1/1.3)."""
WINDOW_STOPS = 2 / 3
"""How far the plan may go from the nominal exposure for whole cycles; further would clip or starve the frame."""
TIE_CYCLES = 0.01
"""Steps whose cycles are this equally good are distinguished by how near they are to the nominal exposure."""
FILL_TIE = 0.05
"""Relative difference of the part of an exposure that a code fills, below which two steps are equally good."""


def _ladder(long_s: Sequence[float], below: Sequence[float], per_stop: int) -> dict[float, float]:
    """True time by name: names count down by equal parts of a stop, and "1 s" is 1 s."""
    names = [*long_s, *(1 / part for part in below)]
    return {name: 2.0 ** ((len(long_s) - place) / per_stop) for place, name in enumerate(names)}


_THIRDS = _ladder(_LONG_THIRDS_S, _BELOW_THIRDS, 3)
_HALVES = _ladder(_LONG_HALVES_S, _BELOW_HALVES, 2)
_THIRDS |= {0.8: _THIRDS[1 / 1.3], 0.6: _THIRDS[1 / 1.6], 0.4: _THIRDS[1 / 2.5], 0.3: _THIRDS[1 / 3], 3.0: _THIRDS[3.2]}
_HALVES |= {0.7: _HALVES[1 / 1.5], 0.3: _HALVES[1 / 3]}


def true_steps_s(named_s: Iterable[float]) -> tuple[float, ...]:
    """True exposure times of the steps that a body names.

    Parameters
    ----------
    named_s
        Exposure times as the body reports them, seconds. The list as a whole shows a ladder in half stops (it has
        1.5 s, 1/45 or 1/90 s) from one in thirds.

    Returns
    -------
    tuple of float
        Seconds, in the order given. A time that is no usual name is the body's own figure and is kept.
    """
    named = tuple(named_s)
    if any(_is_name(step, half) for step in named for half in (1.5, 1 / 45, 1 / 90)):
        return tuple(_true(step, _HALVES) for step in named)
    return tuple(_true(step, _THIRDS) for step in named)


def _is_name(step_s: float, name_s: float) -> bool:
    return abs(step_s / name_s - 1) < _SAME_NAME


def _true(step_s: float, ladder: dict[float, float]) -> float:
    name = min(ladder, key=lambda candidate: abs(math.log(step_s / candidate)))
    return ladder[name] if _is_name(step_s, name) else step_s


def third_stop_steps_s(shortest_s: float = 1 / 4000, longest_s: float = 30.0) -> tuple[float, ...]:
    """True times of the usual ladder in thirds of a stop, ascending: what to plan with when no body can be asked.

    Parameters
    ----------
    shortest_s, longest_s
        Ends of the ladder, by name.
    """
    inside = {true for name, true in _THIRDS.items() if shortest_s * 0.99 <= name <= longest_s * 1.01}
    return tuple(sorted(inside))


def common_steps_s(by_camera: Iterable[Sequence[float]]) -> tuple[float, ...]:
    """Steps that every camera offers (within 1 %), so that all shutters see the same window; ascending."""
    lists = [tuple(steps) for steps in by_camera]
    if not lists:
        return ()
    first, others = lists[0], lists[1:]
    shared = [s for s in first if all(any(abs(s / other - 1) < 0.01 for other in steps) for steps in others)]
    return tuple(sorted(set(shared)))


@dataclass(frozen=True, slots=True)
class Exposure:
    """A camera step that was chosen.

    Attributes
    ----------
    exposure_s
        True exposure time.
    cycles
        Excitation cycles in it; None where there is no excitation.
    """

    exposure_s: float
    cycles: float | None


def part_cycle(cycles: float) -> float:
    """Distance from whole cycles, 0 to 0.5."""
    return abs(cycles - round(cycles))


def choose_exposure(
    steps_s: Sequence[float], nominal_s: float, frequency_hz: float | None, *, half_cycles: bool = False
) -> Exposure | None:
    """The step nearest to whole cycles among those near the nominal exposure.

    Parameters
    ----------
    steps_s
        True exposure times that the cameras offer, seconds. A single one means that the camera's dial decides.
    nominal_s
        What the campaign asks for.
    frequency_hz
        Excitation; None or 0 when the structure is at rest or it is unknown: then the step nearest to nominal is taken.
    half_cycles
        Take the step nearest to half a cycle from whole instead (captures at known phases).

    Returns
    -------
    Exposure or None
        None when no step lies within `WINDOW_STOPS` of the nominal exposure.
    """
    near = [step for step in steps_s if abs(math.log2(step / nominal_s)) <= WINDOW_STOPS + 0.1]
    if not near:
        return None
    if not frequency_hz:
        best = min(near, key=lambda step: abs(math.log2(step / nominal_s)))
        return Exposure(best, None)

    def badness(step: float) -> tuple[float, float]:
        part = part_cycle(step * frequency_hz)
        miss = 0.5 - part if half_cycles else part
        return round(miss / TIE_CYCLES), abs(math.log2(step / nominal_s))

    best = min(near, key=badness)
    return Exposure(best, best * frequency_hz)


def choose_lit_exposure(
    steps_s: Sequence[float], nominal_s: float, cycles_within: Callable[[float], int]
) -> tuple[float, int] | None:
    """The step near the nominal exposure of which whole cycles of a light code fill the largest part.

    Parameters
    ----------
    steps_s
        True exposure times that the cameras offer, seconds.
    nominal_s
        What the campaign asks for.
    cycles_within
        How many cycles of the code fit into an exposure.

    Returns
    -------
    exposure, cycles
        None when no step lies within `WINDOW_STOPS` of the nominal exposure, or no cycle fits.
    """
    near = [step for step in steps_s if abs(math.log2(step / nominal_s)) <= WINDOW_STOPS + 0.1]
    fitting = [(step, cycles) for step in near if (cycles := cycles_within(step)) > 0]
    if not fitting:
        return None
    fullest = max(cycles / step for step, cycles in fitting)
    # Steps that are filled about equally well are distinguished by how near they are to the nominal exposure.
    good = [(step, cycles) for step, cycles in fitting if cycles / step >= (1 - FILL_TIE) * fullest]
    return min(good, key=lambda one: abs(math.log2(one[0] / nominal_s)))
