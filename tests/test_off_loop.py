"""Blocking work on threads of its own: what it returns, what it raises, and what becomes of it when nobody waits."""

from __future__ import annotations

import asyncio
import gc
import threading
import weakref

import pytest

from labdaemon.off_loop import off_loop


def test_it_returns_what_the_function_returns() -> None:
    async def scenario() -> tuple[str, int]:
        return await off_loop(lambda text, number: (text, number), "a", 7)

    assert asyncio.run(scenario()) == ("a", 7)


def test_the_loop_goes_on_meanwhile() -> None:
    started, may_end = threading.Event(), threading.Event()

    def block() -> str:
        started.set()
        assert may_end.wait(10.0)
        return "done"

    async def scenario() -> str:
        task = asyncio.create_task(off_loop(block))
        while not started.is_set():
            await asyncio.sleep(0.001)  # the loop turns
        may_end.set()
        return await task

    assert asyncio.run(scenario()) == "done"


def test_an_error_comes_out_as_it_was() -> None:
    async def scenario() -> None:
        await off_loop(int, "seven")

    with pytest.raises(ValueError, match="seven"):
        asyncio.run(scenario())


@pytest.mark.parametrize("kind", [StopIteration, KeyboardInterrupt, SystemExit, asyncio.CancelledError])
def test_what_would_end_the_loop_comes_out_as_an_ordinary_error(kind: type[BaseException]) -> None:
    def work() -> None:
        raise kind

    async def scenario() -> None:
        await off_loop(work)

    with pytest.raises(RuntimeError, match=f"{kind.__name__} in work"):
        asyncio.run(scenario())


def test_a_caller_that_is_cancelled_waits_no_longer() -> None:
    may_end = threading.Event()

    async def scenario() -> None:
        task = asyncio.create_task(off_loop(may_end.wait, 10.0))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        may_end.set()
        await asyncio.sleep(0.01)  # the thread's result comes to a future that nothing awaits

    asyncio.run(scenario())


class Large:
    """Stands for a peer's megabyte."""


async def test_an_error_is_gone_with_its_frames_without_a_collection():
    seen: list[weakref.ref[Large]] = []

    def fail(large: Large) -> None:
        held = large
        seen.append(weakref.ref(held))
        raise ValueError("no")

    async def call() -> None:
        try:
            await off_loop(fail, Large())
        except ValueError:
            return

    gc.collect()
    gc.disable()
    try:
        for _ in range(3):
            await call()
        for _ in range(200):  # the threads' own ends
            if not any(reference() for reference in seen):
                break
            await asyncio.sleep(0.01)
        assert not any(reference() for reference in seen)
    finally:
        gc.enable()
