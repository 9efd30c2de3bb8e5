"""Runs one process out of memory, as the kernel does it: a memory control group of its own, and its OOM killer."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOTS = (
    (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),  # version 1
    (Path("/sys/fs/cgroup"), "memory.max"),
)
LIMIT_BYTES = 64 << 20
"""What the process may use on top of what it has."""


@contextmanager
def memory_limit(pid: int) -> Iterator[bool]:
    """Limit what a process may allocate from now on; False where this machine does not allow it."""
    group = _make()
    if group is None:
        yield False
        return
    try:
        (group / "cgroup.procs").write_text(str(pid))
        yield True
    finally:
        for _ in range(100):  # the killed process leaves it a moment later
            with suppress(OSError):  # a process in it has not ended yet: the system removes an empty group later
                group.rmdir()
                break
            time.sleep(0.05)


def _make() -> Path | None:
    for root, limit in ROOTS:
        group = root / f"labdaemon-bench-{os.getpid()}"
        try:
            group.mkdir()
            (group / limit).write_text(str(LIMIT_BYTES))
        except OSError:
            with suppress(OSError):
                group.rmdir()
            continue
        return group
    return None
