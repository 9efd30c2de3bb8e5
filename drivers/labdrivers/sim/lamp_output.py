"""The lamp output of the simulated trigger box: constant light, and codes that follow the sync input."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from labdrivers.sim.faults import Faults

FAULTS = {
    "old_firmware": "the box's firmware is of before the lamp output: it knows neither LAMP, CODE nor PLAYED",
    "code_cut": "the code ends in the middle of its second cycle",
}
FULL = 255
LONGEST_CODE, SHORTEST_CODE = 64, 2
SHORTEST_SECTOR_S = 1e-4
SETTLE_S = 1e-3
"""After the last contact, before the code may begin: contacts bounce."""
LATEST_END_S = 5e-4
"""A code must end so long before the first shutter closes."""
BRIGHT_AGAIN_S = 0.1
"""The constant light returns so long after the shutters have closed."""
PERIOD_CHANGE = 0.01
"""A period of the sync that differs by more than this, relative, from the one at the start ends a code."""
LARGEST_SLIP = 0.005
"""Part of a cycle by which the sync may have run away from the code when one of its cycles ends; more ends the code."""
PERIOD_TICKS_PER_US = 16

Sync = Callable[[float], tuple[float, float] | None]


class LampPin(Protocol):
    """What the output is wired to."""

    def __call__(self, t: float, level: float) -> None:
        """The pin has this level, 0 to 1, from `t` on; times ascend."""
        ...


@dataclass(slots=True)
class ArmedCode:
    """A code as the host gave it: brightness of each sector 0 to 255, and where in the cycle it begins."""

    levels: tuple[int, ...]
    cycles: int
    open_s: float
    turn: float


@dataclass(slots=True)
class CodePlay:
    """What became of the code of one shot; times on the rig's clock."""

    code: ArmedCode
    released_s: float
    contacts_s: tuple[float | None, ...]
    state: Literal["WAIT", "PLAY", "DONE", "CUT"] = "WAIT"
    start_s: float | None = None
    sync_s: float | None = None
    period_s: float | None = None
    first_sector: int = 0
    cycles: int = 0

    @property
    def bright_s(self) -> float:
        """When the constant light returns."""
        seen = [t for t in self.contacts_s if t is not None]
        return max([self.released_s, *seen]) + self.code.open_s + BRIGHT_AGAIN_S


@dataclass(slots=True)
class LampOutput:
    """The output. Whoever calls holds the box's lock.

    Attributes
    ----------
    pin
        What it is wired to.
    levels
        How many levels it can show; 2 where it only switches.
    tick_error
        Relative error of the box's clock, positive when it is fast.
    contact_patience_s
        A code whose contacts have not closed by then is not played.
    """

    pin: LampPin
    levels: int = 256
    tick_error: float = 0.0
    contact_patience_s: float = 2.0
    faults: Faults = field(default_factory=lambda: Faults(FAULTS))
    level: int = FULL
    armed: ArmedCode | None = None
    plays: dict[int, CodePlay] = field(default_factory=dict)
    _current: CodePlay | None = None
    _random: random.Random = field(default_factory=lambda: random.Random(5))

    def restart(self, now: float) -> None:
        """Power-up: the firmware switches the lamp on, so that a camera can be focused; codes are forgotten."""
        self.level, self.armed, self._current = FULL, None, None
        self.plays.clear()
        self.pin(now, 1.0)

    def is_busy(self) -> bool:
        """Whether a code waits, is played, or the light has not returned since."""
        return self._current is not None

    def allows(self, level: int) -> bool:
        """Whether it can show this brightness."""
        return 0 <= level <= FULL and (self.levels > 2 or level in (0, FULL))

    def set_level(self, level: int, now: float) -> None:
        """Constant light; during a code it takes effect afterwards."""
        self.level = level
        if self._current is None:
            self.pin(now, level / FULL)

    def refusal(self, code: ArmedCode, period_s: float) -> str | None:
        """Why this code cannot be played."""
        if not SHORTEST_CODE <= len(code.levels) <= LONGEST_CODE:
            return f"RANGE {SHORTEST_CODE} to {LONGEST_CODE} sectors"
        if not all(self.allows(level) for level in code.levels):
            return "RANGE the lamp can only switch"
        if period_s / len(code.levels) < SHORTEST_SECTOR_S:
            return f"RANGE a sector is shorter than {SHORTEST_SECTOR_S * 1e6:.0f} us"
        if code.cycles < 1 or code.cycles * period_s > code.open_s:
            return f"RANGE {code.cycles} cycles of {period_s * 1e6:.0f} us do not fit into {code.open_s * 1e6:.0f} us"
        return None

    def begin(self, shot: int, released_s: float, contacts_s: Sequence[float | None]) -> None:
        """The shutters were released with a code armed: dark until it begins."""
        if self.armed is None:
            return
        self._current = self.plays[shot] = CodePlay(self.armed, released_s, tuple(contacts_s))
        self.plays.pop(shot - 8, None)
        self.armed = None
        self.pin(released_s, 0.0)

    def advance(self, now: float, sync: Sync) -> float | None:
        """Do what is due; returns when there is more to do, None when there is nothing.

        Parameters
        ----------
        sync
            Last edge of the sync before a time, and its period.
        """
        play = self._current
        if play is None:
            return None
        due: float | None = None
        if play.state == "WAIT":
            due = self._start(play, now, sync)
        while play.state == "PLAY":
            due = self._boundary(play)
            if due > now:
                break
            self._next_cycle(play, due, sync)
        if play.state in ("DONE", "CUT"):
            due = play.bright_s
            if due <= now:
                self.pin(due, self.level / FULL)
                self._current = None
                return None
        return due

    @staticmethod
    def _boundary(play: CodePlay) -> float:
        """End of the cycle that is being played."""
        assert play.start_s is not None
        assert play.period_s is not None
        return play.start_s + (play.cycles + 1) * play.period_s

    def _start(self, play: CodePlay, now: float, sync: Sync) -> float:
        seen = [t for t in play.contacts_s if t is not None]
        if len(seen) < len(play.contacts_s) or not seen:
            late_s = play.released_s + self.contact_patience_s
            if now >= late_s:
                play.state = "CUT"
            return late_s
        ready_s = max(seen) + SETTLE_S
        if now < ready_s:
            return ready_s
        edge = sync(ready_s)
        if edge is None:
            play.state = "CUT"
            return ready_s
        edge_s, period_s = edge
        count = len(play.code.levels)
        sectors = ((ready_s - edge_s) / period_s - play.code.turn) * count
        play.first_sector = math.ceil(sectors)
        play.start_s = ready_s + (play.first_sector - sectors) / count * period_s
        play.sync_s, play.period_s = edge_s, self._measured(period_s)
        if play.start_s + play.code.cycles * play.period_s > min(seen) + play.code.open_s - LATEST_END_S:
            play.state, play.start_s = "CUT", None
            return ready_s
        play.state = "PLAY"
        self._write_cycle(play, play.start_s)
        return self._boundary(play)

    def _measured(self, period_s: float) -> float:
        """The period in whole ticks of the box's clock: the mean of eight, each edge with its latency."""
        ticks = (period_s * 1e6 * (1 + self.tick_error) + self._random.gauss(0.0, 0.4)) * PERIOD_TICKS_PER_US
        return round(ticks) / PERIOD_TICKS_PER_US * 1e-6 / (1 + self.tick_error)

    def _next_cycle(self, play: CodePlay, at_s: float, sync: Sync) -> None:
        """A cycle is over at `at_s`: play the next one, or end."""
        assert play.period_s is not None
        play.cycles += 1
        edge = sync(at_s)
        if edge is None or self._has_run_away(play, at_s, edge):
            play.state = "CUT"
            self.pin(at_s, 0.0)
        elif play.cycles == play.code.cycles:
            play.state = "DONE"
            self.pin(at_s, 0.0)
        else:
            self._write_cycle(play, at_s)
            if self.faults.strike("code_cut"):
                play.state = "CUT"
                self.pin(at_s + 0.5 * play.period_s, 0.0)

    @staticmethod
    def _has_run_away(play: CodePlay, at_s: float, edge: tuple[float, float]) -> bool:
        """Whether the sync has another period than the code, or has drifted away from it since the start."""
        assert play.start_s is not None
        assert play.sync_s is not None
        assert play.period_s is not None
        edge_s, period_s = edge
        slip = math.remainder(((at_s - edge_s) - (play.start_s - play.sync_s)) / play.period_s, 1.0)
        return abs(period_s / play.period_s - 1) > PERIOD_CHANGE or abs(slip) > LARGEST_SLIP

    def _write_cycle(self, play: CodePlay, at_s: float) -> None:
        """Edges of one cycle, from a sector's boundary on."""
        assert play.period_s is not None
        count = len(play.code.levels)
        for place in range(count):
            level = play.code.levels[(play.first_sector + place) % count]
            self.pin(at_s + place / count * play.period_s, level / FULL)
