"""Questions and answers with a SCPI controller: nothing in the protocol numbers a reply, so order is all there is.

A late answer would be taken for the next question's. So after anything unexpected the link is *dirty*: before the
next question it asks for the identity until the known one comes back, and whatever came before that is thrown away.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.scpi_commands import ScpiCommands
from labdrivers.serial_line import SerialLine

LONGEST_QUEUE = 30
"""Keysight's error queues hold 20; more entries than this are no queue."""
IDENTITY_TRIES = 4  # questions without an answer; late answers of an earlier program are read away first
HASTY_TRIES = 3  # on the way to a stop there is less time
IDENTITY_QUESTIONS = 8  # that are answered at once cost little

T = TypeVar("T")


class ScpiLink:
    """Exchanges over a `SerialLine`, one at a time, whichever thread asks.

    Parameters
    ----------
    line
        The port.
    commands
        The controller's spelling.
    """

    def __init__(self, line: SerialLine, commands: ScpiCommands) -> None:
        self._line, self._commands = line, commands
        self._lock = threading.RLock()
        self._dirty = False
        self._identity: str | None = None
        self._wait_limit = threading.local()

    @property
    def device(self) -> str:
        """Name in the rig file."""
        return self._line.device

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Keep other threads' exchanges out, so that a check and the command that depends on it belong together.

        Raises
        ------
        TransportError
            In haste only: another thread's exchange does not end.
        """
        haste_s = self._wait_limit_s
        if not self._lock.acquire(timeout=-1 if haste_s is None else haste_s):
            raise TransportError("is busy with an exchange that does not end", device=self.device)
        try:
            yield
        finally:
            self._lock.release()

    @contextmanager
    def limit_waits(self, timeout_s: float) -> Iterator[None]:
        """Let this thread's exchanges wait no longer than this for an answer, or for their turn: for stopping."""
        before, self._wait_limit.timeout_s = self._wait_limit_s, min(timeout_s, self._line.settings.timeout_s)
        try:
            yield
        finally:
            self._wait_limit.timeout_s = before

    def reopen(self) -> None:
        """Open a wire that broke, or that gave no answer, anew. What waits on the old one ends with an error.

        Raises
        ------
        TransportError
            The port does not open.
        """
        self._line.open()
        self._dirty = True

    def identify(self) -> str:
        """Ask who is there until the same answer came twice running: the first may be left over from an earlier talk.

        A row of late answers may be the same as well. So nothing may follow the second one, and a switch's answer is no
        identity.

        Raises
        ------
        TransportError
            The controller does not answer.
        ProtocolError
            What comes is no identity, or never the same.
        """
        with self.exclusive():
            self._line.write(b"\n")  # ends whatever half a command an earlier program left
            self._line.discard()
            before: str | None = None
            fault: DeviceError | None = None
            tries = IDENTITY_TRIES if self._wait_limit_s is None else HASTY_TRIES
            for _ in range(IDENTITY_QUESTIONS):
                try:
                    answer = self._query(self._commands.identify)
                except (TransportError, ProtocolError) as exc:
                    fault, tries = exc, tries - 1
                    if not tries:
                        break
                    self._line.discard()
                    continue
                if not answer.isprintable() or answer.upper() in self._switch_replies:
                    self._line.discard()
                    continue
                if answer == before and not self._line.discard():
                    self._identity, self._dirty = answer, False
                    return answer
                before = answer
            raise fault or ProtocolError(
                f"gives no identity twice running (last {before!r}); check baud rate and wiring", device=self.device
            )

    def write(self, command: str) -> None:
        """Send a setting; wait for its acknowledgement if the controller gives one."""
        with self.exclusive(), self._note_faults():
            self._resync()
            self._line.write(command.encode("ascii") + b"\n")
            if self._commands.acknowledge:
                answer = self._read()
                if answer != self._commands.acknowledge:
                    raise ProtocolError(
                        f"answered {answer!r} to {command!r}, not {self._commands.acknowledge!r}", device=self.device
                    )

    def write_at_once(self, command: str) -> None:
        """Send a setting even while another thread waits for a reply: for stopping."""
        # A controller that acknowledges settings has now two answers to give, and who waits may see the wrong one.
        self._dirty = self._dirty or bool(self._commands.acknowledge)
        self._line.write(command.encode("ascii") + b"\n")

    def query(self, question: str) -> str:
        """One question, one line of answer."""
        with self.exclusive(), self._note_faults():
            self._resync()
            return self._query(question)

    def query_number(self, question: str) -> float:
        """A question whose answer is a number; asked once more if it is not."""
        return self._query_parsed(question, _number, "where a number belongs")

    def query_switch(self, question: str) -> bool:
        """Whether an output is on; asked once more if the answer is neither on nor off."""

        def switch(answer: str) -> bool:
            if answer.upper() in self._commands.on_replies:
                return True
            if answer.upper() in self._commands.off_replies:
                return False
            raise ValueError

        return self._query_parsed(question, switch, "which is neither on nor off")

    def _query_parsed(self, question: str, parse: Callable[[str], T], complaint: str) -> T:
        for last in (False, True):
            try:
                answer = self.query(question)
                try:
                    return parse(answer)
                except ValueError:
                    self._dirty = True
                    raise ProtocolError(
                        f"answered {answer!r} to {question!r}, {complaint}", device=self.device
                    ) from None
            except ProtocolError:
                if last:
                    raise
        raise AssertionError("unreachable")

    def check_errors(self, doing: str) -> None:
        """Empty the error queue; raise `DeviceRefused` with its entries if there were any."""
        if not self._commands.error:
            return
        errors: list[str] = []
        for _ in range(LONGEST_QUEUE):
            number, entry = self._query_parsed(self._commands.error, _entry, "where an error number belongs")
            if number == 0:
                break
            errors.append(entry)
        else:
            raise ProtocolError(f"error queue never empties ({errors[-1]})", device=self.device)
        if errors:
            raise DeviceRefused(f"refused while {doing}: {'; '.join(errors)}", device=self.device)

    @property
    def _switch_replies(self) -> set[str]:
        return {*self._commands.on_replies, *self._commands.off_replies}

    def _query(self, question: str) -> str:
        self._line.write(question.encode("ascii") + b"\n")
        return self._read()

    def _read(self) -> str:
        raw = self._line.read_line(time.monotonic() + self._timeout_s)
        try:
            return raw.decode("ascii").strip()
        except UnicodeDecodeError:
            raise ProtocolError(f"sent {raw[:40]!r}, which is no text; check baud rate", device=self.device) from None

    def _resync(self) -> None:
        if not self._dirty:
            return
        if self._identity is None:
            self.identify()
            return
        self._line.discard()
        self._line.write(self._commands.identify.encode("ascii") + b"\n")
        deadline = time.monotonic() + self._timeout_s
        heard: bytes | None = None
        while time.monotonic() < deadline:  # a device that babbles must not keep us here
            try:
                answer = self._line.read_line(deadline)
            except TransportError:
                if heard is None:
                    raise
                break
            if answer.decode("ascii", "replace").strip() == self._identity:
                if not self._line.discard():
                    self._dirty = False
                    return
                self._line.write(
                    self._commands.identify.encode("ascii") + b"\n"
                )  # that was a late answer to an earlier one
            heard = answer
        raise ProtocolError(
            f"does not come back into step (answers {(heard or b'')[:40]!r}, which is no text of its own); check baud "
            "rate and wiring, or power it off and on",
            device=self.device,
        )

    @property
    def _wait_limit_s(self) -> float | None:
        """Longest wait of this thread's exchanges where it is in haste."""
        found: float | None = getattr(self._wait_limit, "timeout_s", None)
        return found

    @property
    def _timeout_s(self) -> float:
        haste_s = self._wait_limit_s
        return self._line.settings.timeout_s if haste_s is None else haste_s

    @contextmanager
    def _note_faults(self) -> Iterator[None]:
        try:
            yield
        except DeviceError:
            self._dirty = True
            raise


def _number(answer: str) -> float:
    """First number of an answer, whatever unit follows it."""
    value = float(answer.replace(",", " ").split()[0] if answer.strip() else "")
    if not math.isfinite(value):
        raise ValueError(answer)
    return value


def _entry(answer: str) -> tuple[int, str]:
    """Number and whole text of an error queue's entry."""
    return int(float(answer.split(",", maxsplit=1)[0])), answer
