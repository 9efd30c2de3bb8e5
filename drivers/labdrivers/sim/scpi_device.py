"""A function generator that speaks SCPI as Keysight's 33500 series does, with the table's amplifier on its output.

It has the long and short forms, ``;`` between commands, unit suffixes, MIN and MAX, a power-on state (1 kHz, 0.1 Vpp,
output off) and an error queue of twenty. Its answers are bytes; the table it moves is the rig's.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable
from typing import Protocol

from labdrivers.sim.faults import Faults
from labdrivers.sim.wire import WireDevice

IDENTITY = "Agilent Technologies,33522B,MY52500001,4.00-1.19-2.00-58-00"
FAULTS = {
    "silent": "answers nothing",
    "rubbish": "answers noise instead of text",
    "no_line_end": "answers without ever ending a line",
    "late": "answers `value` seconds late (default 3)",
    "hang_up": "cuts the connection instead of answering",
    "half_answer": "cuts the connection in the middle of an answer",
    "stuck_output": "keeps the output on although ordered off",
    "output_stays_off": "keeps the output off although ordered on",
    "ignores_level": "takes no new level, and does not say so",
    "ignores_frequency": "takes no new frequency, and does not say so",
    "queue_full": "its error queue is full of old errors",
    "refuses": "answers every setting with an error in its queue",
    "reboots": "loses power for a moment: power-on state, output off",
    "deaf": "answers questions and takes no setting at all, and does not say so",
    "absent": "its port is gone: whoever opens it is cut off at once",
    "wrong_value": "reports a level `value` times the true one (default 1.5)",
}
QUEUE_LENGTH = 20
FREQUENCY_HZ = (1e-6, 30e6)
LEVEL_VPP = (0.002, 20.0)  # into an open circuit, as an amplifier's input is
SUFFIXES = {"UHZ": 1e-6, "MHZ": 1e6, "KHZ": 1e3, "HZ": 1.0, "VPP": 1.0, "MVPP": 1e-3, "V": 1.0, "MV": 1e-3, "DEG": 1.0}


class GeneratorLoad(Protocol):
    """What hangs on the generator's output."""

    def drive(self, *, frequency_hz: float, level_v: float, running: bool, phase_rad: float) -> None:
        """The output from now on; `level_v` zero to peak, `phase_rad` the PHASe offset."""
        ...


class ScpiDevice(WireDevice):
    """The generator.

    Parameters
    ----------
    load
        Amplifier and table.
    output_switch
        False for a 33120A, which has no OUTPut subsystem.
    """

    def __init__(self, load: GeneratorLoad, *, identity: str = IDENTITY, output_switch: bool = True) -> None:
        super().__init__()
        self.faults = Faults(FAULTS)
        self._load, self._identity, self._has_switch = load, identity, output_switch
        self._input = bytearray()
        self._errors: deque[str] = deque()
        self._handlers = self._make_handlers()
        self._power_on()

    def _power_on(self) -> None:
        self._function, self._frequency_hz, self._level_vpp = "SIN", 1000.0, 0.1
        self._offset_v, self._phase_deg = 0.0, 0.0
        self._output = not self._has_switch
        self._errors.clear()
        self._apply()

    def receive(self, data: bytes) -> None:
        """Bytes from the host; every whole line is a program message."""
        self._input += data
        while (end := self._input.find(b"\n")) >= 0:
            line = bytes(self._input[:end])
            del self._input[: end + 1]
            self._message(line.decode("latin-1").strip())
        if len(self._input) > 1000:
            self._input.clear()
            self._error(-363, "Input buffer overrun")

    def _message(self, line: str) -> None:
        if self.faults.strike("reboots"):
            self._power_on()
            return
        if self.faults.strike("queue_full"):
            for _ in range(QUEUE_LENGTH):
                self._error(-113, "Undefined header")
        answers = []
        for command in filter(None, (part.strip() for part in line.split(";"))):
            answer = self._command(command)
            if answer is not None:
                answers.append(answer)
        if answers:
            self._answer(";".join(answers))

    def _answer(self, text: str) -> None:
        if self.faults.strike("silent"):
            return
        whole = text.encode() + b"\n"
        if self.faults.strike("hang_up"):
            self.hang_up()
        elif self.faults.strike("half_answer"):
            self.send(whole[: len(whole) // 2])
            self.hang_up()
        elif self.faults.strike("rubbish"):
            self.send(b"\xff\x00\xfe~\x81{\n")
        elif self.faults.strike("no_line_end"):
            self.send(b"U" * 6000)
        elif self.faults.is_on("late"):
            delay = self.faults.value("late", 3.0)
            self.faults.strike("late")
            self.send_later(delay, whole)
        else:
            self.send(whole)

    def _command(self, command: str) -> str | None:
        header, _, argument = command.lstrip(":").partition(" ")
        for pattern, handler in self._handlers:
            if pattern.fullmatch(header.upper()):
                return handler(argument.strip().upper())
        self._error(-113, "Undefined header")
        return None

    def _make_handlers(self) -> list[tuple[re.Pattern[str], Callable[[str], str | None]]]:
        prefix = r"(SOUR(CE)?[12]?:)?"
        table: list[tuple[str, Callable[[str], str | None]]] = [
            (r"\*IDN\?", lambda _: self._identity),
            (r"\*CLS", self._clear),
            (r"\*RST", self._reset),
            (r"\*OPC\?", lambda _: "1"),
            (r"SYST(EM)?:ERR(OR)?(:NEXT)?\?", lambda _: self._next_error()),
            (r"SYST(EM)?:REM(OTE)?", lambda _: None),
            (prefix + r"FUNC(TION)?(:SHAP(E)?)?", self._set_function),
            (prefix + r"FUNC(TION)?(:SHAP(E)?)?\?", lambda _: self._function),
            (prefix + r"FREQ(UENCY)?", self._set_frequency),
            (prefix + r"FREQ(UENCY)?\?", lambda a: _number(_limit(a, FREQUENCY_HZ, self._frequency_hz))),
            (prefix + r"VOLT(AGE)?", self._set_level),
            (prefix + r"VOLT(AGE)?\?", lambda a: _number(_limit(a, LEVEL_VPP, self._reported_level()))),
            (prefix + r"VOLT(AGE)?:UNIT", self._set_unit),
            (prefix + r"VOLT(AGE)?:UNIT\?", lambda _: "VPP"),
            (prefix + r"VOLT(AGE)?:OFFS(ET)?", self._set_offset),
            (prefix + r"VOLT(AGE)?:OFFS(ET)?\?", lambda _: _number(self._offset_v)),
            (prefix + r"PHAS(E)?", self._set_phase),
            (prefix + r"PHAS(E)?\?", lambda _: _number(self._phase_deg)),
        ]
        amplifier_on: Callable[[], bool] | None = getattr(self._load, "amplifier_on", None)
        if amplifier_on is not None:  # a controller that knows its amplifier
            table.append((r"AMPL(IFIER)?:STAT(E)?\?", lambda _: str(int(amplifier_on()))))
        if self._has_switch:
            table += [(r"OUTP(UT)?[12]?", self._set_output), (r"OUTP(UT)?[12]?\?", lambda _: str(int(self._output)))]
        return [(re.compile(pattern), handler) for pattern, handler in table]

    def _clear(self, _: str) -> None:
        self._errors.clear()

    def _reset(self, _: str) -> None:
        self._power_on()

    def _error(self, number: int, text: str) -> None:
        if len(self._errors) >= QUEUE_LENGTH:
            self._errors[-1] = '-350,"Queue overflow"'
        else:
            self._errors.append(f'{number:+d},"{text}"')

    def _next_error(self) -> str:
        return self._errors.popleft() if self._errors else '+0,"No error"'

    def _refused(self) -> bool:
        if self.faults.strike("deaf"):
            return True
        if self.faults.strike("refuses"):
            self._error(-221, "Settings conflict")
            return True
        return False

    def _set_function(self, argument: str) -> None:
        if argument not in ("SIN", "SINUSOID"):
            self._error(-224, "Illegal parameter value")
        elif not self._refused():
            self._function = "SIN"

    def _set_unit(self, argument: str) -> None:
        if argument != "VPP":
            self._error(-224, "Illegal parameter value")

    def _set_frequency(self, argument: str) -> None:
        value = self._parse(argument, FREQUENCY_HZ)
        if value is not None and not self._refused() and not self.faults.strike("ignores_frequency"):
            self._frequency_hz = round(value, 6)
            self._apply()

    def _set_level(self, argument: str) -> None:
        value = self._parse(argument, LEVEL_VPP)
        if value is not None and not self._refused() and not self.faults.strike("ignores_level"):
            self._level_vpp = float(f"{value:.4g}") if value >= 1 else round(value, 4)
            self._apply()

    def _set_offset(self, argument: str) -> None:
        value = self._parse(argument, (-10.0, 10.0))
        if value is not None and not self._refused():
            self._offset_v = value

    def _set_phase(self, argument: str) -> None:
        value = self._parse(argument, (-360.0, 360.0))
        if value is not None and not self._refused():
            self._phase_deg = value
            self._apply()

    def _set_output(self, argument: str) -> None:
        if argument not in ("ON", "OFF", "1", "0"):
            self._error(-224, "Illegal parameter value")
            return
        on = argument in ("ON", "1")
        if self._refused() or self.faults.strike("output_stays_off" if on else "stuck_output"):
            return
        self._output = on
        self._apply()

    def _reported_level(self) -> float:
        if self.faults.is_on("wrong_value"):
            factor = self.faults.value("wrong_value", 1.5)
            self.faults.strike("wrong_value")
            return self._level_vpp * factor
        return self._level_vpp

    def _parse(self, argument: str, limits: tuple[float, float]) -> float | None:
        low, high = limits
        if argument in ("MIN", "MINIMUM", "MAX", "MAXIMUM"):
            return low if argument.startswith("MIN") else high
        found = re.fullmatch(r"([-+]?[0-9.]+(?:E[-+]?[0-9]+)?)\s*([A-Z]*)", argument)
        try:
            value = float(found[1]) * (SUFFIXES[found[2]] if found[2] else 1.0) if found else math.nan
        except (ValueError, KeyError):
            value = math.nan
        if math.isnan(value):
            self._error(-109 if not argument else -104, "Missing parameter" if not argument else "Data type error")
            return None
        if not low <= value <= high:
            self._error(-222, "Data out of range")
            return None
        return value

    def _apply(self) -> None:
        self._load.drive(
            frequency_hz=self._frequency_hz,
            level_v=self._level_vpp / 2,
            running=self._output,
            phase_rad=math.radians(self._phase_deg),
        )


def _limit(argument: str, limits: tuple[float, float], value: float) -> float:
    return {"MIN": limits[0], "MAX": limits[1]}.get(argument[:3], value)


def _number(value: float) -> str:
    return f"{value:+.15E}"
