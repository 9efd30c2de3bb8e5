"""The shaker's wire as the guardian uses it: one hard stop and its confirmation, over pyserial."""

from __future__ import annotations

import re
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import serial

from labdaemon.guardian.recipe import StopRecipe, WireExchange

IDENTIFY_TRIES = 5  # the dead daemon had at most a few questions on the wire
CONFIRM_TRIES = 3
"""The answer that means rest is asked for so often in one try, each time after another stop."""
QUIET_S, LONGEST_DRAIN_S = 0.05, 0.4
"""After a stop the wire is read until it was quiet for so long, but not for ever."""
RECHECK_S = 0.3
"""What the dead daemon had still sent through a serial server can arrive after the stop, so rest is seen twice, so far
apart."""
LONGEST_LINE = 4096  # no answer is as long; a line without an end must not fill the memory
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
FAULTS = (serial.SerialException, OSError, termios.error, ValueError, TypeError, AttributeError)
"""What pyserial raises for a port that is gone; the last two are its own when a port goes during a call."""


class StopFailure(Exception):
    """The shaker did not confirm; the text says what it did instead."""


class SerialPort(Protocol):
    """What is used of pyserial."""

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes within the port's own short timeout."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        ...

    def close(self) -> None:
        """Give the port back."""
        ...


def open_port(recipe: StopRecipe) -> SerialPort:
    """Open the shaker's port. No lock is asked for: a stop must not wait for who holds the port."""
    is_rfc2217 = recipe.port.lower().startswith("rfc2217:")
    port: SerialPort = serial.serial_for_url(
        recipe.port,
        timeout=0.02,
        write_timeout=None if is_rfc2217 else 1.0,  # pyserial's RFC 2217 port has none
        **recipe.setup._asdict(),
    )
    return port


def stop_shaker(
    recipe: StopRecipe,
    open_port: Callable[[StopRecipe], SerialPort] = open_port,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """One try: open the port, stop hard, and see the table at rest, twice.

    Raises
    ------
    StopFailure
        The port does not open, the wire is silent, or the shaker says that it is not at rest.
    """
    try:
        port = open_port(recipe)
    except FAULTS as exc:
        raise StopFailure(f"port {recipe.port} does not open ({exc})") from exc
    try:
        wire = _ShakerWire(port, recipe)
        wire.stop()
        wire.confirm()
        sleep(RECHECK_S)
        wire.confirm()
    except FAULTS as exc:
        raise StopFailure(f"connection on {recipe.port} lost ({exc})") from exc
    finally:
        with suppress(*FAULTS):  # the other side was faster: there is nothing left to give back
            port.close()


class _ShakerWire:
    """An open port."""

    def __init__(self, port: SerialPort, recipe: StopRecipe) -> None:
        self._port, self._recipe = port, recipe
        self._buffer = b""

    def stop(self) -> None:
        """Send all that stops, without a pause, and throw away what is answered: `confirm` decides."""
        for exchange in self._recipe.stop:
            self._port.write(exchange.send)
        end = time.monotonic() + LONGEST_DRAIN_S
        quiet_at = time.monotonic() + QUIET_S
        while time.monotonic() < min(end, quiet_at):
            if self._port.read(256):
                quiet_at = time.monotonic() + QUIET_S
        self._buffer = b""

    def confirm(self) -> None:
        """See the table at rest; what is not at rest is stopped again."""
        trouble = ""
        for _ in range(CONFIRM_TRIES):
            trouble = self._unconfirmed()
            if not trouble:
                return
            self.stop()
        raise StopFailure(trouble)

    def _unconfirmed(self) -> str:
        """What is answered that is not rest; empty at rest."""
        if self._recipe.identify is not None:
            self._find_step(self._recipe.identify)
        for exchange in self._recipe.confirm:
            self._port.write(exchange.send)
            answer = self._read_line(exchange.within_s)
            if answer is None:
                raise StopFailure(f"no answer on {self._recipe.port}")
            if not is_expected(exchange, answer):
                return f"answers {answer[:40]!r} to {exchange.send!r}, which is not rest"
        return ""

    def _find_step(self, identify: WireExchange) -> None:
        """Ask who is there until the same answer came twice running and no other waits behind it.

        An acknowledgement is no name, and neither is the answer that means rest: late ones would pass for both.
        """
        before: str | None = None
        for _ in range(IDENTIFY_TRIES):
            self._port.write(identify.send)
            answer = self._read_line(identify.within_s)
            while answer is not None and self._is_acknowledgement(answer):
                answer = self._read_line(identify.within_s)
            if answer is None:
                raise StopFailure(f"no answer on {self._recipe.port}")
            if answer == before and not self._is_rest(answer) and not self._more_waits():
                return
            before = answer
        raise StopFailure(f"answers out of step on {self._recipe.port} ({(before or '')[:40]!r})")

    def _is_acknowledgement(self, answer: str) -> bool:
        expected = [exchange for exchange in self._recipe.stop if exchange.answer is not None]
        return any(is_expected(exchange, answer) for exchange in expected)

    def _is_rest(self, answer: str) -> bool:
        return any(exchange.answer is not None and is_expected(exchange, answer) for exchange in self._recipe.confirm)

    def _more_waits(self) -> bool:
        """Whether something came that was not read yet. A port behind a socket says at most that one byte waits."""
        if not self._buffer:
            self._buffer += self._port.read(1)
        return bool(self._buffer)

    def _read_line(self, within_s: float) -> str | None:
        """The next line that is not empty; None when none came in time."""
        deadline = time.monotonic() + within_s
        while True:
            while self._recipe.line_end in self._buffer:
                line, _, self._buffer = self._buffer.partition(self._recipe.line_end)
                text = line.strip(b" \t\r\n\x00").decode("latin-1")
                if text:
                    return text
            if len(self._buffer) > LONGEST_LINE:
                self._buffer = b""
            if time.monotonic() > deadline:
                return None
            self._buffer += self._port.read(1)
            waiting = getattr(self._port, "in_waiting", 0)
            if waiting:
                self._buffer += self._port.read(waiting)


def is_expected(exchange: WireExchange, answer: str) -> bool:
    """Whether an answer is the expected one."""
    if exchange.answer is not None and not re.fullmatch(exchange.answer, answer, re.IGNORECASE):
        return False
    if exchange.at_most is None:
        return True
    number = NUMBER.search(answer)
    return number is not None and abs(float(number[0])) <= exchange.at_most
