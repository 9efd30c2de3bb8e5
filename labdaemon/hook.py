"""Runs a command that a person wrote into the rig file: a program of others, of which nothing is believed.

Its output is bytes in no particular encoding and of any length, and it may leave children behind that keep the pipe
open. Only the end of the output is kept, for a message.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

KEPT_BYTES = 4096  # the last words are what a person wants to read
BLOCK_BYTES = 1 << 16  # a pipe holds as much

LAST_OUTPUT_S = 0.5
"""How long to read on after the command's end: what it wrote last is still in the pipe."""

LONGEST_LINE = 200  # of the log


@dataclass(frozen=True, slots=True)
class HookResult:
    """How a command ended.

    Attributes
    ----------
    status
        Exit status; negative for the number of the signal that ended it.
    last_line
        The last line that it printed, made printable; empty if it printed none.
    """

    status: int
    last_line: str


class HookError(Exception):
    """The command could not be started, or did not end in time."""


def run_hook(command: Sequence[str], timeout_s: float, stdin: bytes = b"") -> HookResult:
    """Run a command without a shell and wait for its end; blocks.

    Parameters
    ----------
    command
        Program and arguments.
    timeout_s
        After which it is killed with all its children, seconds.
    stdin
        What it can read; it need not.

    Raises
    ------
    HookError
        It cannot be started, or was killed because it did not end.
    """
    try:
        process = subprocess.Popen(
            list(command),
            stdin=subprocess.PIPE if stdin else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except (OSError, ValueError, subprocess.SubprocessError) as exc:  # ValueError: a NUL or a surrogate in an argument
        raise HookError(str(exc)) from exc
    assert process.stdout is not None
    kept = bytearray()
    reader = threading.Thread(target=_read, args=(process.stdout, kept), name="hook output", daemon=True)
    reader.start()
    if process.stdin is not None:
        # On a thread: a command that does not read must not be waited for, however large the text is.
        threading.Thread(target=_write, args=(process.stdin, stdin), name="hook input", daemon=True).start()
    try:
        status = process.wait(timeout_s)
    except subprocess.TimeoutExpired as exc:
        with suppress(OSError):  # it has just ended by itself
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise HookError(f"does not end within {timeout_s:g} s") from exc
    finally:
        # A child that was left behind may hold the pipe for good: the thread then reads on, and keeps no more.
        reader.join(LAST_OUTPUT_S)
    return HookResult(status, _last_line(bytes(kept)))


def _read(stream: IO[bytes], kept: bytearray) -> None:
    """Read to the end, so that the command never waits for a full pipe, and keep the last of it."""
    with suppress(OSError, ValueError), stream:  # the command's end closed it: what has come is kept
        while block := os.read(stream.fileno(), BLOCK_BYTES):
            kept += block
            del kept[:-KEPT_BYTES]


def _write(stream: IO[bytes], text: bytes) -> None:
    with suppress(OSError, ValueError), stream:  # it ended, or closed its input, before it had read all
        stream.write(text)


def _last_line(output: bytes) -> str:
    lines = [line for line in output.decode("utf-8", "replace").splitlines() if line.strip()]
    line = lines[-1].strip() if lines else ""
    return "".join(letter if letter.isprintable() else "?" for letter in line)[:LONGEST_LINE]
