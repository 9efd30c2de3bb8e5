"""The simulated lamp: how bright it is at each moment, as its output pin and its rise time make it."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np

from labdrivers.sim.lens import FloatArray

KEEP_EDGES = 20_000
"""Edges remembered: hundreds of coded exposures."""


@dataclass(frozen=True, slots=True)
class LampPlay:
    """Brightness of the lamp over time, in parts of its full brightness.

    Attributes
    ----------
    edges_s
        (n,) times at which the pin changes its level, ascending.
    levels
        (n,) level from each edge on; before the first the lamp is at `before`.
    before
        Level before the first edge.
    rise_s
        Time from dark to full brightness and back; the brightness changes linearly meanwhile.
    ambient
        Other light in the room, in parts of the lamp's full brightness.
    """

    edges_s: tuple[float, ...] = field(default=())
    levels: tuple[float, ...] = field(default=())
    before: float = 1.0
    rise_s: float = 0.0
    ambient: float = 0.0

    def __call__(self, t: FloatArray) -> FloatArray:
        """All light (n,) at times (n,): the lamp's and the room's."""
        times = np.asarray(t, float)
        if not self.edges_s:
            return np.full(times.shape, self.before + self.ambient)
        edges = np.asarray(self.edges_s)
        levels = np.concatenate(([self.before], self.levels))
        index = np.searchsorted(edges, times, side="right")
        now, earlier = levels[index], levels[np.maximum(index - 1, 0)]
        since = times - edges[np.maximum(index - 1, 0)]
        risen = np.clip(since / self.rise_s, 0.0, 1.0) if self.rise_s > 0 else np.ones(times.shape)
        lamp = np.where(index > 0, earlier + (now - earlier) * risen, self.before)
        return np.asarray(lamp + self.ambient)

    def relative(self, t: FloatArray) -> FloatArray:
        """The same in parts of all light with the lamp at full brightness."""
        return self(t) / (1.0 + self.ambient)


@dataclass(slots=True)
class LampHistory:
    """Levels of the lamp's pin so far: from full brightness on, since the lab's lamp is on before anything is wired."""

    times_s: list[float] = field(default_factory=list)
    levels: list[float] = field(default_factory=list)
    before: float = 1.0

    def add(self, t: float, level: float) -> None:
        """The pin has this level from `t` on; what was planned for later times is void."""
        keep = bisect_left(self.times_s, t)
        del self.times_s[keep:], self.levels[keep:]
        if level != (self.levels[-1] if self.levels else self.before):
            self.times_s.append(t)
            self.levels.append(level)
        if len(self.times_s) > KEEP_EDGES:
            half = KEEP_EDGES // 2
            self.before = self.levels[half - 1]
            del self.times_s[:half], self.levels[:half]

    def play(self, from_s: float, to_s: float, rise_s: float, ambient: float) -> LampPlay | None:
        """What the lamp did in a window; None where it was at full brightness throughout."""
        first = bisect_left(self.times_s, from_s - rise_s)
        last = bisect_left(self.times_s, to_s)
        before = self.levels[first - 1] if first else self.before
        if first == last and before == 1.0:
            return None
        return LampPlay(tuple(self.times_s[first:last]), tuple(self.levels[first:last]), before, rise_s, ambient)


def play_code(
    levels: tuple[float, ...],
    start_s: float,
    period_s: float,
    cycles: int,
    *,
    rise_s: float = 0.0,
    ambient: float = 0.0,
    before: float = 0.0,
) -> LampPlay:
    """A code in equal sectors of a period, repeated over whole cycles, dark before and after.

    Parameters
    ----------
    levels
        Brightness of each sector, 0 to 1.
    start_s, period_s
        Beginning of the first sector, and the length of one cycle.
    cycles
        How many times the code is played.
    """
    sector = period_s / len(levels)
    count = len(levels) * cycles
    edges = [start_s + index * sector for index in range(count)] + [start_s + count * sector]
    return LampPlay(tuple(edges), (*(levels * cycles), 0.0), before, rise_s, ambient)
