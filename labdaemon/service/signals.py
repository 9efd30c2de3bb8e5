"""Signals that end a process: all of them that can be caught bring the table to rest first."""

from __future__ import annotations

import resource
import signal
from contextlib import suppress

UNCATCHABLE = {signal.SIGKILL, signal.SIGSTOP}
FAULTS = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT}
"""The process itself is broken, and cannot be trusted to stop anything: the guardian does."""
HARMLESS = {signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH, signal.SIGPIPE, signal.SIGXFSZ}
"""By default they end nothing; the last two are errors of a write in Python."""
SUSPENDING = {signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU}
"""A daemon that is stopped by its terminal cannot watch the table: these are ignored."""


def ending_signals() -> list[int]:
    """Numbers of all signals that end a process and can be caught, the real-time ones included.

    Those that whoever started us has ignored (``nohup``) stay ignored; SIGINT and SIGTERM never are.
    """
    found = signal.valid_signals() - UNCATCHABLE - FAULTS - HARMLESS - SUSPENDING
    always = {signal.SIGINT, signal.SIGTERM}
    return sorted(number for number in found if number in always or signal.getsignal(number) != signal.SIG_IGN)


def ignore_suspension() -> None:
    """Go on where a terminal would stop the process."""
    for number in SUSPENDING:
        signal.signal(number, signal.SIG_IGN)


def forbid_core_dumps() -> None:
    """A dump of this process would hold the shaker's port, and delay the guardian, for as long as it is written.

    A limit of 1 byte, unlike 0, also keeps the kernel from piping the dump to a program (core(5)).
    """
    hard = resource.getrlimit(resource.RLIMIT_CORE)[1]
    if hard != 0:
        with suppress(OSError, ValueError):  # the unit's system call filter refuses; it sets the limit itself
            resource.setrlimit(resource.RLIMIT_CORE, (1, hard))


def exit_status(number: int) -> int:
    """Exit status after a signal, with the table at rest: 0 after SIGTERM, else 128 and its number, as shells do."""
    return 0 if number == signal.SIGTERM else 128 + number


def name_of(number: int) -> str:
    """A signal's name, or what it is where it has none."""
    try:
        return signal.Signals(number).name
    except ValueError:  # real-time signals between the first and the last have no name
        return f"real-time signal {number}"
