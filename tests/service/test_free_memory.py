"""Free memory goes back to the system when the process has grown, and only then."""

from __future__ import annotations

import asyncio
import ctypes

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.service import free_memory
from labdaemon.service.free_memory import CHECK_S, GROWTH_BYTES, give_memory_back, release_free_memory, resident_bytes

BLOCK = 64 << 10


def test_it_is_given_back_after_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, held, released = SimulatedClock(), [100 << 20], []
    monkeypatch.setattr(free_memory, "resident_bytes", lambda: held[0])
    monkeypatch.setattr(free_memory, "release_free_memory", lambda: released.append(held[0]))

    async def at_once(work, *args):
        return work(*args)

    monkeypatch.setattr(free_memory, "off_loop", at_once)

    async def main() -> None:
        keeping = asyncio.create_task(give_memory_back(clock))
        for grown in (0, GROWTH_BYTES, 1, 0):
            held[0] += grown
            await clock.sleep(CHECK_S)
        keeping.cancel()

    clock.run(main())
    assert released == [(100 << 20) + GROWTH_BYTES + 1]


def test_what_lies_free_between_blocks_in_use_is_released() -> None:
    if resident_bytes() == 0 or not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("needs glibc, and Linux's report of what a process holds")
    blocks = [bytearray(BLOCK) for _ in range(1000)]
    kept = blocks[::50]
    del blocks
    before = resident_bytes()
    release_free_memory()
    assert resident_bytes() < before - 1000 * BLOCK // 2
    assert len(kept) == 20
