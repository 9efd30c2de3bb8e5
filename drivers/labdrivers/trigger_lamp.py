"""The trigger box's lamp output: constant light, and codes that follow the excitation; see `trigger_wire`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from labdaemon.capture.lamp import LightRequest, PlayedLight
from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, UsageError
from labdrivers.trigger_wire import FULL_LEVEL, TURN_PARTS, elapsed_us

POLL_S = 0.02
SD_EDGE_S = 3e-6
"""Standard deviation of the lamp's edges against the sync: two inputs and one output of a 4 µs clock."""
PERIOD_WITHIN = 0.01
"""A code whose period differs by more than this, relative, from the excitation's was timed by something else."""
BRIGHT_AGAIN_S = 0.15
"""The constant light has returned so long after the shutters have closed, and the lamp has risen."""
MOST_CYCLES, MOST_SECTORS = 65535, 64


@dataclass(frozen=True, slots=True)
class _ArmedLight:
    request: LightRequest
    frequency_hz: float
    shot: int = 0


class LampControl:
    """The lamp output of a box.

    Parameters
    ----------
    name
        The box's name in the rig file.
    exchange
        Sends one request and returns the values of its reply.
    """

    def __init__(self, name: str, exchange: Callable[[str], tuple[str, ...]]) -> None:
        self._name, self._exchange = name, exchange
        self._levels: int | None = None
        self._playing: _ArmedLight | None = None
        self._bright_s = 0.0

    def forget(self) -> None:
        """The box was connected to anew."""
        self._levels = self._playing = None

    def set_level(self, level: float) -> None:
        """Constant light, 0 to 1.

        Raises
        ------
        DeviceRefused
            No lamp output, or it cannot show this level.
        """
        if not 0 <= level <= 1:
            raise UsageError(f"a lamp has no brightness {level}; give 0 to 1")
        self.wait_bright()
        self._ask(f"LAMP {round(level * FULL_LEVEL)}")

    def arm(self, light: LightRequest, exposure_s: float, frequency_hz: float) -> None:
        """Have the box play a code with its next shot.

        Raises
        ------
        DeviceRefused
            It does not; the message says why.
        """
        if self._playing is None:
            self.wait_bright()
        self._playing = None
        shown = self._shown(light)
        if not 1 <= light.cycles <= MOST_CYCLES:
            raise UsageError(f"a code cannot be played for {light.cycles} cycles")
        if light.cycles > exposure_s * frequency_hz:
            raise DeviceRefused(
                f"{light.cycles} cycles of the code at {frequency_hz:g} Hz do not fit into an exposure of "
                f"{exposure_s:g} s",
                device=self._name,
            )
        turn = round(light.phase_rad / (2 * math.pi) * TURN_PARTS) % TURN_PARTS
        levels = "".join(f"{round(value * FULL_LEVEL):02X}" for value in shown)
        words = self._ask(f"CODE {light.cycles} {round(exposure_s * 1e6)} {turn} {levels}")
        if len(words) != 1 or not words[0].isdigit():
            raise ProtocolError(f"answered {' '.join(words)!r} where the sync's period belongs", device=self._name)
        request = LightRequest(shown, light.cycles, turn / TURN_PARTS * 2 * math.pi)
        self._playing = _ArmedLight(request, frequency_hz)
        try:
            self._check_period(int(words[0]), frequency_hz)
        except DeviceError as exc:
            self.disarm()
            raise DeviceRefused(str(exc).removeprefix(f"{self._name}: "), device=self._name) from None

    def disarm(self) -> None:
        """No code with the next shot."""
        self._playing = None
        self._ask("CODE 0")

    def fired(self, shot: int, exposure_s: float) -> None:
        """The shot that the code is played with; its shutters have just opened."""
        self._bright_s = time.monotonic() + exposure_s + BRIGHT_AGAIN_S
        if self._playing is not None:
            self._playing = _ArmedLight(self._playing.request, self._playing.frequency_hz, shot)

    def wait_bright(self) -> None:
        """Wait until the constant light has returned after a code: before that the box takes no shot."""
        time.sleep(max(0.0, self._bright_s - time.monotonic()))

    def read_played(self, timeout_s: float) -> PlayedLight:
        """What was played with the last shot.

        Raises
        ------
        DeviceError
            It did not end well, or did not end in time.
        """
        playing = self._playing
        if playing is None or not playing.shot:
            raise UsageError("no code was played")
        deadline = time.monotonic() + timeout_s
        while True:
            state, times, cycles = self._describe(playing.shot)
            if state in ("DONE", "CUT") or time.monotonic() >= deadline:
                break
            time.sleep(POLL_S)
        self._playing = None
        asked = playing.request
        if state != "DONE" or cycles != asked.cycles or None in times:
            raise DeviceError(
                f"played {cycles} of {asked.cycles} cycles of the light code ({_why(state, times[0])}): the frames of "
                "this shot hold a light that is not known",
                device=self._name,
            )
        start, sync, period = (int(value or 0) for value in times)
        self._check_period(period, playing.frequency_hz)
        sectors = (elapsed_us(start, sync) / period - asked.phase_rad / (2 * math.pi)) * len(asked.brightness)
        sd_sectors = 4 * SD_EDGE_S * 1e6 / period * len(asked.brightness) + 0.02
        if abs(sectors - round(sectors)) > sd_sectors:
            raise DeviceError(
                f"began the light code {sectors - round(sectors):+.2f} sectors away from an edge of the code; its sync "
                "input may be noisy",
                device=self._name,
            )
        omega = 2 * math.pi * 1e6 / period
        # Half a tick of the period, over half of the cycles, shifts the code's mean phase.
        sd_phase_rad = omega * math.hypot(SD_EDGE_S, 0.3e-6 * asked.cycles / 2)
        return PlayedLight(asked.brightness, asked.cycles, asked.phase_rad, sd_phase_rad, period * 1e-6)

    def _shown(self, light: LightRequest) -> tuple[float, ...]:
        """The brightness as the output's levels show it."""
        values = light.brightness
        if not 2 <= len(values) <= MOST_SECTORS or not all(0 <= value <= 1 for value in values):
            raise UsageError(f"a code has 2 to {MOST_SECTORS} sectors of brightness 0 to 1")
        if self._levels is None:
            words = self._ask("LAMP")
            if len(words) != 2 or not all(word.isdigit() for word in words):
                raise ProtocolError(f"describes its lamp as {' '.join(words)!r}", device=self._name)
            self._levels = int(words[1])
        if self._levels == 2 and any(value not in (0.0, 1.0) for value in values):
            raise DeviceRefused(
                "its lamp output only switches: a code of other levels than 0 and 1 needs PWM", device=self._name
            )
        return tuple(round(value * FULL_LEVEL) / FULL_LEVEL for value in values)

    def _check_period(self, period_us: int, wanted_hz: float) -> None:
        if period_us <= 0 or abs(period_us * 1e-6 * wanted_hz - 1) > PERIOD_WITHIN:
            seen = 1e6 / period_us if period_us > 0 else math.inf
            raise DeviceError(
                f"sees {seen:.4g} Hz on its sync input where the excitation has {wanted_hz:.4g} Hz: the light code "
                "would not follow it; check what the input is wired to",
                device=self._name,
            )

    def _describe(self, shot: int) -> tuple[str, tuple[int | None, ...], int]:
        try:
            words = self._ask(f"PLAYED {shot}")
        except DeviceRefused as exc:
            if "UNKNOWN" not in str(exc):
                raise
            raise DeviceError(
                "knows no light code of this shot: it has restarted meanwhile, or another shot took the code",
                device=self._name,
            ) from None
        try:
            if len(words) != 7 or words[1] not in ("WAIT", "PLAY", "DONE", "CUT"):
                raise ValueError
            return words[1], tuple(None if word == "-" else int(word) for word in words[2:5]), int(words[5])
        except ValueError:
            raise ProtocolError(f"describes a light code as {' '.join(words)!r}", device=self._name) from None

    def _ask(self, request: str) -> tuple[str, ...]:
        """One exchange; a box that does not know the verb, or has no lamp, is refused in words a person can use."""
        try:
            return self._exchange(request)
        except DeviceRefused as exc:
            text, verb = str(exc), request.split(" ", maxsplit=1)[0]
            if f"SYNTAX {verb}" in text:
                why = "its firmware is of before the lamp output; update it, or leave [lamp] out of the rig file"
            elif "NOLAMP" in text:
                why = "it has no lamp output; leave [lamp] out of the rig file"
            elif "NOSYNC" in text:
                why = "NOSYNC: no edge on its sync input, so that no light code can follow the excitation"
            elif "RANGE" in text and verb == "CODE":
                why = f"it does not play this light code: {text.partition('RANGE ')[2]}"
            else:
                raise
            raise DeviceRefused(why, device=self._name) from None


def _why(state: str, start: int | None) -> str:
    match state, start:
        case "CUT", None:
            return (
                "no sync, a contact that did not close, or too little time in which all shutters were open: raise "
                "margin_s of [lamp] to the difference of the bodies' lags"
            )
        case "CUT", _:
            return "the excitation's sync was lost, changed or drifted"
        case _:
            return "it has not ended"
