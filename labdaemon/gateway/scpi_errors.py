"""Errors as SCPI-1999 numbers them, and the queue in which a client finds them (volume 2, chapter 21.8)."""

from __future__ import annotations

from collections import deque

from labdaemon.stream import messages
from labdaemon.stream.text_limits import bounded_text

TEXTS = {
    0: "No error",
    -100: "Command error",
    -101: "Invalid character",
    -102: "Syntax error",
    -103: "Invalid separator",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -112: "Program mnemonic too long",
    -113: "Undefined header",
    -120: "Numeric data error",
    -131: "Invalid suffix",
    -138: "Suffix not allowed",
    -151: "Invalid string data",
    -200: "Execution error",
    -203: "Command protected",
    -211: "Trigger ignored",
    -213: "Init ignored",
    -220: "Parameter error",
    -221: "Settings conflict",
    -222: "Data out of range",
    -223: "Too much data",
    -224: "Illegal parameter value",
    -230: "Data corrupt or stale",
    -240: "Hardware error",
    -300: "Device-specific error",
    -310: "System error",
    -350: "Queue overflow",
    -363: "Input buffer overrun",
    -410: "Query INTERRUPTED",
    -430: "Query DEADLOCKED",
}
"""The standard's own words."""
MOST_ERRORS = 32
"""In the queue; the last place then says that there were more."""
LONGEST_DETAIL = 200
"""Characters; the standard allows 255 for text and detail together."""
QUERY_ERROR, DEVICE_ERROR, EXECUTION_ERROR, COMMAND_ERROR = 4, 8, 16, 32
"""Bits of the standard event status register (IEEE 488.2, 11.5.1)."""
OPERATION_COMPLETE, POWER_ON = 1, 128

_OF_CODE = {
    messages.PARSE_ERROR: -102,
    messages.INVALID_REQUEST: -102,
    messages.METHOD_NOT_FOUND: -113,
    messages.INVALID_PARAMS: -224,
    messages.INTERNAL_ERROR: -310,
    messages.BUSY: -211,
    messages.FORBIDDEN: -203,
    messages.LIMITS: -222,
    messages.NOT_FOUND: -220,
    messages.WRONG_STATE: -221,
    messages.DEVICE: -240,
}


class ScpiError(Exception):
    """Something a client's line asked for that cannot be done.

    Attributes
    ----------
    number
        Of SCPI-1999, as -113.
    detail
        What it is about, one sentence.
    """

    def __init__(self, number: int, detail: str = "") -> None:
        super().__init__(number, detail)
        self.number = number
        self.detail = detail

    @property
    def event_bit(self) -> int:
        """The bit that it sets in the standard event status register."""
        match -self.number // 100:
            case 1:
                return COMMAND_ERROR
            case 2:
                return EXECUTION_ERROR
            case 4:
                return QUERY_ERROR
        return DEVICE_ERROR

    def __str__(self) -> str:
        text = TEXTS.get(self.number, "Device-specific error")
        if self.detail:
            text += f";{bounded_text(self.detail, LONGEST_DETAIL)}"
        return f'{self.number},"{text.replace(chr(34), chr(39))}"'


def error_of_answer(error: dict[str, object]) -> ScpiError:
    """What a JSON-RPC error is in SCPI's numbers."""
    code = error.get("code")
    number = _OF_CODE.get(code, -300) if isinstance(code, int) else -300
    return ScpiError(number, str(error.get("message", "")))


class ErrorQueue:
    """First in, first out, and bounded."""

    def __init__(self) -> None:
        self._errors: deque[ScpiError] = deque()

    def __len__(self) -> int:
        return len(self._errors)

    def add(self, error: ScpiError) -> None:
        """Put one in; a full queue replaces its last error by -350."""
        if len(self._errors) < MOST_ERRORS:
            self._errors.append(error)
        else:
            self._errors[-1] = ScpiError(-350)

    def take(self) -> str:
        """The oldest error as it is answered; ``0,"No error"`` where there is none."""
        return str(self._errors.popleft()) if self._errors else '0,"No error"'

    def take_all(self) -> str:
        """All errors, separated by commas."""
        return ",".join([self.take() for _ in range(len(self._errors))] or [self.take()])

    def clear(self) -> None:
        """Forget all."""
        self._errors.clear()
