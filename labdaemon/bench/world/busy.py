"""A process that keeps a core, the memory and a disk busy: ``python -m labdaemon.bench.world.busy FILE``."""

from __future__ import annotations

import os
import sys
import time

MEMORY_BYTES = 64 << 20  # larger than a cache, so that the memory itself is kept busy
WRITE_BYTES = 1 << 20  # as a copying program writes
PAGE_BYTES = 4096  # every page is touched, or the system would give none
SPIN_S = 0.1  # a worker looks at the clock between such stretches of work


def main(file: str) -> None:
    """Touch memory, compute, and write with fsync, until killed."""
    memory, block = bytearray(MEMORY_BYTES), os.urandom(WRITE_BYTES)
    with open(file, "wb", buffering=0) as disk:
        while True:
            for place in range(0, MEMORY_BYTES, PAGE_BYTES):
                memory[place] = (memory[place] + 1) % 256
            end = time.monotonic() + SPIN_S
            while time.monotonic() < end:
                sum(range(1000))
            disk.seek(0)
            disk.write(block)
            os.fsync(disk.fileno())


if __name__ == "__main__":
    main(sys.argv[1])
