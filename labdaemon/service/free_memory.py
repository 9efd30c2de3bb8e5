"""Gives memory that is free back to the system.

The C library keeps what was freed between blocks that are still in use. After a crowd of clients with long messages
that was some hundred megabytes, all of them free, which other programs of a small computer then lack.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

from labdaemon.clock import Clock
from labdaemon.off_loop import off_loop

CHECK_S = 30.0
GROWTH_BYTES = 32 << 20
"""Free memory is given back when the process holds so much more than after the last time."""


async def give_memory_back(clock: Clock) -> None:
    """Give back what is free whenever the process has grown, until cancelled."""
    last = resident_bytes()
    while True:
        await clock.sleep(CHECK_S)
        if resident_bytes() > last + GROWTH_BYTES:
            await off_loop(release_free_memory)
            last = resident_bytes()


def release_free_memory() -> None:
    """Give free memory back; nothing where the C library has no such function (glibc has)."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def resident_bytes() -> int:
    """What this process holds in memory; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
