"""The trigger box, simulated at its serial wire: see `labdrivers.trigger_wire` for what it says.

Its outputs are wired to the rig's cameras (a cable each, not USB), its sync input to the generator, its enable line to
the amplifier, its lamp output to the rig's lamp. Times are those at which things truly happen on the rig's clock, read
through the box's own clock of 4 µs steps with a few microseconds of jitter.
"""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from labdrivers.sim.faults import Faults
from labdrivers.sim.lamp_output import ArmedCode, LampOutput
from labdrivers.sim.wire import WireDevice
from labdrivers.trigger_wire import CLOCK_WRAP, LONGEST_HOLD_MS, OUTPUTS, TURN_PARTS, decode, encode

FAULTS = {
    "silent": "answers nothing",
    "rubbish": "answers noise instead of text",
    "late": "answers `value` seconds late (default 1)",
    "hang_up": "cuts the connection instead of answering",
    "half_answer": "cuts the connection in the middle of an answer",
    "wrong_checksum": "answers with a broken checksum",
    "wrong_sequence": "answers with another request's number",
    "babble": "sends a stream of noise before each answer",
    "reboots": "restarts: forgets its shots, enable line down, answers nothing",
    "no_release": "its release lines are dead: accepts a shot, no shutter opens",
    "no_contact": "sees no flash-sync contact",
    "no_sync": "sees no edge of the excitation's sync",
    "busy": "refuses every shot as busy",
    "enable_stuck": "its enable line stays up although it says that it dropped",
    "absent": "its port is gone: whoever opens it is cut off at once",
    "enable_drops": "its enable line falls although heartbeats come",
}
REMEMBERED = 8
CONTACT_PATIENCE_S = 2.0
TICK_US = 4


class RigSignals(Protocol):
    """The rig's signals on the box's wires, apart from the cameras; times on the rig's clock."""

    def enable(self, up: bool) -> None:
        """The amplifier's enable line."""
        ...

    def sync(self, t: float) -> tuple[float, float] | None:
        """Last rising edge of the generator's sync before `t` and its period, seconds; None without excitation."""
        ...


class Shutter(Protocol):
    """A camera at its release cable."""

    def release(self, t: float) -> float | None:
        """Press at `t`; return when the shutter is fully open (its contact closes then), None if it does not fire."""
        ...


@dataclass(slots=True)
class _ScheduledShot:
    number: int
    due_s: float
    released: bool = False
    contacts_s: list[float | None] = field(default_factory=list)
    sync_s: float | None = None
    period_s: float | None = None


class TriggerDevice(WireDevice):
    """The box.

    Parameters
    ----------
    shutters
        At most four, in the order of the outputs.
    excitation
        The rig's other wires.
    clock
        The rig's clock, seconds.
    lamp
        Its lamp output; None for a box without one.
    tick_error
        Relative error of the box's own clock, positive when it is fast.
    """

    def __init__(
        self,
        shutters: Sequence[Shutter],
        excitation: RigSignals,
        *,
        clock: Callable[[], float] = time.monotonic,
        seed: int = 0,
        lamp: LampOutput | None = None,
        tick_error: float = 0.0,
    ) -> None:
        super().__init__()
        if len(shutters) > OUTPUTS:
            raise ValueError(f"a box has {OUTPUTS} outputs")
        self.faults = Faults(FAULTS)
        self._shutters, self._excitation, self._clock = list(shutters), excitation, clock
        self._random, self.lamp, self._tick_error = random.Random(seed), lamp, tick_error
        if lamp is not None:
            lamp.tick_error = tick_error
        self._input = bytearray()
        self._state = threading.Condition(threading.RLock())
        self._running = True
        self._restart()
        self._thread = threading.Thread(target=self._keep_time, name="trigger box", daemon=True)
        self._thread.start()

    @property
    def enable_up(self) -> bool:
        """State of the enable line."""
        return self._enable_until is not None

    def external_edge(self) -> None:
        """An edge on the external input: the shaker's control system wants a capture."""
        with self._state:
            if self._armed:
                self._new_shot(self._clock())

    def shut_down(self) -> None:
        """Power off: the enable line falls."""
        with self._state:
            self._running = False
            self._drop()
            self._state.notify_all()

    def _restart(self) -> None:
        with self._state:
            self._started_s = self._clock()
            self._enable_until: float | None = None
            self._excitation.enable(False)
            self._armed = False
            self._shots: dict[int, _ScheduledShot] = {}
            self._last_shot = 0
            self._served: tuple[int, str, str] = (0, "", "")
            if self.lamp is not None:
                self.lamp.restart(self._started_s)

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        self._input += data
        while (end := self._input.find(b"\n")) >= 0:
            line = bytes(self._input[:end])
            del self._input[: end + 1]
            frame = decode(">", line)
            if frame is not None:
                self._request(frame.sequence, " ".join(frame.words))
        del self._input[:-200]

    def catch_up(self) -> None:
        """Do with the lamp what is due by now: the chip's timers do not wait for a thread of this computer."""
        with self._state:
            if self.lamp is not None:
                self.lamp.advance(self._clock(), self._sync)

    def _request(self, sequence: int, text: str) -> None:
        if self.faults.strike("reboots"):
            self._restart()
            return
        with self._state:
            self.catch_up()
            if (sequence, text) == self._served[:2] and text != "ID":
                reply = self._served[2]
            else:
                reply = self._serve(text.split(" "))
                self._served = (sequence, text, reply)
        self._answer(sequence, reply)

    def _answer(self, sequence: int, reply: str) -> None:
        if self.faults.strike("silent"):
            return
        line = encode("<", sequence, reply)
        if self.faults.strike("babble"):
            self.send(bytes(self._random.randrange(256) for _ in range(300)) + b"\n")
        if self.faults.strike("hang_up"):
            self.hang_up()
        elif self.faults.strike("half_answer"):
            self.send(line[: len(line) // 2])
            self.hang_up()
        elif self.faults.strike("rubbish"):
            self.send(b"\xf0\x9f\x00\xaa\x55\n")
        elif self.faults.strike("wrong_checksum"):
            self.send(line[:-2] + (b"0" if line[-2:-1] != b"0" else b"1") + b"\n")
        elif self.faults.strike("wrong_sequence"):
            self.send(encode("<", sequence % 60000 + 7, reply))
        elif self.faults.is_on("late"):
            delay = self.faults.value("late", 1.0)
            self.faults.strike("late")
            self.send_later(delay, line)
        else:
            self.send(line)

    def _serve(self, words: list[str]) -> str:
        verb, arguments = words[0], words[1:]
        if verb in ("LAMP", "CODE", "PLAYED") and not (self.lamp and self.lamp.faults.is_on("old_firmware")):
            return self._serve_lamp(verb, arguments)
        if not all(word.isdigit() and len(word) < 11 for word in arguments):
            return "ERR SYNTAX numbers expected"
        numbers = [int(word) for word in arguments]
        match verb, numbers:
            case "ID", []:
                return f"OK labtrigger 1 SIM0001 {OUTPUTS}"
            case "NOW", []:
                return f"OK {self._stamp(self._clock())}"
            case (("EN" | "HB"), [ms]):
                return self._hold_enable(verb == "EN", ms)
            case "DROP", []:
                self._drop()
                return "OK 0"
            case "FIRE", [_]:
                return self._fire(None)
            case "FIRE", [_, delay_us]:
                return self._fire(delay_us * 1e-6)
            case (("ARM" | "DISARM"), [*_]):
                self._armed = verb == "ARM"
                return f"OK {self._last_shot}"
            case "SHOT", [number]:
                return self._describe(number)
        return f"ERR SYNTAX {verb}"

    def _serve_lamp(self, verb: str, arguments: list[str]) -> str:
        """Requests about the lamp output."""
        lamp = self.lamp
        if lamp is None:
            return "ERR NOLAMP this box has no lamp output"
        if not all(word.isdigit() and len(word) < 11 for word in arguments[:3]):
            return "ERR SYNTAX numbers expected"
        match verb, arguments:
            case "LAMP", []:
                return f"OK {lamp.level} {lamp.levels}"
            case "LAMP", [level]:
                if not lamp.allows(int(level)):
                    return "ERR RANGE the lamp cannot show this level"
                lamp.set_level(int(level), self._clock())
                return f"OK {lamp.level}"
            case "CODE", ["0"]:
                lamp.armed = None
                return "OK 0"
            case "CODE", [cycles, open_us, turn, levels]:
                return self._arm_code(lamp, int(cycles), int(open_us), int(turn), levels)
            case "PLAYED", [number]:
                return self._describe_play(lamp, int(number))
        return f"ERR SYNTAX {verb}"

    def _arm_code(self, lamp: LampOutput, cycles: int, open_us: int, turn: int, levels: str) -> str:
        now = self._clock()
        if lamp.is_busy() or self._shot_in_progress(now):
            return "ERR BUSY a shot or a code is in progress"
        try:
            code = ArmedCode(tuple(bytes.fromhex(levels)), cycles, open_us * 1e-6, turn / TURN_PARTS)
        except ValueError:
            return "ERR SYNTAX two hexadecimal digits a sector expected"
        sync = self._sync(now)
        if sync is None:
            return "ERR NOSYNC no edge on the sync input"
        refusal = lamp.refusal(code, sync[1])
        if refusal is not None:
            return f"ERR {refusal}"
        lamp.armed = code
        return f"OK {round(sync[1] * 1e6 * (1 + self._tick_error))}"

    def _describe_play(self, lamp: LampOutput, number: int) -> str:
        play = lamp.plays.get(number)
        now = self._stamp(self._clock())
        if play is None:
            return "ERR UNKNOWN no code was played with this shot"
        period = "-" if play.period_s is None else str(round(play.period_s * 1e6 * (1 + self._tick_error)))
        times = f"{self._stamp_or_dash(play.start_s)} {self._stamp_or_dash(play.sync_s)}"
        return f"OK {number} {play.state} {times} {period} {play.cycles} {now}"

    def _hold_enable(self, raise_it: bool, ms: int) -> str:
        if not 0 < ms <= LONGEST_HOLD_MS:
            return f"ERR RANGE 1 to {LONGEST_HOLD_MS} ms"
        if self.faults.strike("enable_drops"):
            self._drop()
        elif raise_it or self._enable_until is not None:
            if self._enable_until is None:
                self._excitation.enable(True)
            self._enable_until = self._clock() + ms / 1000
            self._state.notify_all()
        return f"OK {int(self.enable_up)}"

    def _drop(self) -> None:
        if self._enable_until is not None:
            self._enable_until = None
            if not self.faults.is_on("enable_stuck"):
                self._excitation.enable(False)

    def _fire(self, delay_s: float | None) -> str:
        now = self._clock()
        is_playing = self.lamp is not None and self.lamp.is_busy()
        if self.faults.strike("busy") or is_playing or self._shot_in_progress(now):
            return "ERR BUSY a shot is in progress"
        due = now
        if delay_s is not None:
            sync = self._sync(now)
            if sync is None:
                return "ERR NOSYNC no edge on the sync input"
            edge, period = sync
            due = edge + period * math.floor((now - edge) / period + 1) + delay_s
        self._new_shot(due)
        return f"OK {self._last_shot}"

    def _shot_in_progress(self, now: float) -> bool:
        return any(self._shot_state(shot, now) != "DONE" for shot in self._shots.values())

    def _new_shot(self, due_s: float) -> None:
        self._last_shot += 1
        self._shots[self._last_shot] = _ScheduledShot(self._last_shot, due_s)
        self._shots.pop(self._last_shot - REMEMBERED, None)
        self._state.notify_all()

    def _sync(self, t: float) -> tuple[float, float] | None:
        return None if self.faults.strike("no_sync") else self._excitation.sync(t)

    def _keep_time(self) -> None:
        """What the chip's timers do: release when due, drop the enable line when no heartbeat came."""
        with self._state:
            while self._running:
                now = self._clock()
                if self._enable_until is not None and now >= self._enable_until:
                    self._drop()
                waiting = [shot for shot in self._shots.values() if not shot.released]
                for shot in waiting:
                    if shot.due_s <= now:
                        self._release(shot)
                dues = [shot.due_s for shot in waiting if not shot.released]
                if self._enable_until is not None:
                    dues.append(self._enable_until)
                if self.lamp is not None:
                    next_s = self.lamp.advance(now, self._sync)
                    dues += [] if next_s is None else [next_s]
                self._state.wait(max(0.0, min(dues) - now) if dues else None)

    def _release(self, shot: _ScheduledShot) -> None:
        shot.released = True
        sync = self._sync(shot.due_s)
        if sync is not None:
            shot.sync_s, shot.period_s = sync
        blind = self.faults.strike("no_contact")
        dead = self.faults.strike("no_release")
        opened = [None if dead else shutter.release(shot.due_s) for shutter in self._shutters]
        shot.contacts_s = [None if blind else t for t in opened] + [None] * (OUTPUTS - len(opened))
        if self.lamp is not None:
            self.lamp.begin(shot.number, shot.due_s, shot.contacts_s[: len(opened)])

    def _shot_state(self, shot: _ScheduledShot, now: float) -> str:
        if not shot.released:
            return "WAIT"
        wired = shot.contacts_s[: len(self._shutters)]
        if now > shot.due_s + CONTACT_PATIENCE_S or all(t is not None and t <= now for t in wired):
            return "DONE"
        return "OPEN"

    def _describe(self, number: int) -> str:
        shot = self._shots.get(number)
        if shot is None:
            return "ERR UNKNOWN no such shot"
        now = self._clock()
        contacts = [t if t is not None and t <= now else None for t in shot.contacts_s] or [None] * OUTPUTS
        release = shot.due_s if shot.released else None
        stamps = " ".join(self._stamp_or_dash(t) for t in (release, *contacts, shot.sync_s))
        period = "-" if shot.period_s is None else str(round(shot.period_s * 1e6))
        return f"OK {number} {self._shot_state(shot, now)} {stamps} {period} {self._stamp(now)}"

    def _stamp_or_dash(self, t: float | None) -> str:
        return "-" if t is None else str(self._stamp(t))

    def _stamp(self, t: float) -> int:
        """The box's clock: 4 µs steps, a microsecond or two of interrupt latency (the same for the same instant)."""
        jitter_us = random.Random(t).gauss(0.0, 2.0)
        ticks = round(((t - self._started_s) * 1e6 * (1 + self._tick_error) + jitter_us) / TICK_US)
        return ticks * TICK_US % CLOCK_WRAP
