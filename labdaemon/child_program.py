"""Runs a module of ours as a process of its own, at low priority: what takes seconds of a processor and may fail.

Whatever becomes of it, the caller is not held up for longer than it says, and nothing is left running when the caller
is cancelled.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

LONGEST_COMPLAINT = 300


@dataclass(frozen=True, slots=True)
class ProgramResult:
    """How a program ended.

    Attributes
    ----------
    status
        Exit status.
    output
        What it wrote to stdout.
    complaint
        Last line of what it wrote to stderr, cut to a length for logs.
    """

    status: int
    output: bytes
    complaint: str


async def run_module(*words: str, longest_s: float, niceness: int) -> ProgramResult:
    """Run ``python -m`` with these words, and wait for its end.

    Parameters
    ----------
    longest_s
        After which it is killed with all its children, seconds.
    niceness
        Added to our own, so that it takes what others leave.

    Raises
    ------
    OSError
        It could not be started.
    TimeoutError
        It did not end in time.
    """
    pipe = asyncio.subprocess.PIPE
    child: Any = await asyncio.create_subprocess_exec(
        sys.executable, "-m", *words, stdin=asyncio.subprocess.DEVNULL, stdout=pipe, stderr=pipe, start_new_session=True
    )
    try:
        with suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, child.pid, os.getpriority(os.PRIO_PROCESS, 0) + niceness)
        async with asyncio.timeout(longest_s):
            output, complaint = await child.communicate()
    finally:
        if child.returncode is None:
            with suppress(OSError):  # it ends at this moment
                os.killpg(child.pid, signal.SIGKILL)
            await child.wait()
    last = complaint.decode(errors="replace").strip().rpartition("\n")[2]
    return ProgramResult(child.returncode, output, last[-LONGEST_COMPLAINT:])
