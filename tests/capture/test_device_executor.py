from __future__ import annotations

import asyncio
import threading
import time

import pytest

from labdaemon.capture.device_executor import MAX_STUCK, InlineExecutor, ThreadExecutor
from labdaemon.clock import SimulatedClock
from labdaemon.errors import ProtocolError, TransportError


async def test_calls_run_one_after_the_other_on_one_thread():
    line = ThreadExecutor("shaker")
    seen: list[tuple[int, int]] = []

    def call(number: int) -> int:
        seen.append((number, threading.get_ident()))
        return number

    assert await asyncio.gather(*(line.call(lambda n=n: call(n), 60.0) for n in range(5))) == [0, 1, 2, 3, 4]
    assert [number for number, _ in seen] == [0, 1, 2, 3, 4]
    assert {thread for _, thread in seen}.isdisjoint({threading.get_ident()})
    assert len({thread for _, thread in seen}) == 1
    line.close()


async def test_an_error_comes_back_as_it_is():
    line = ThreadExecutor("shaker")

    def fail() -> None:
        raise ProtocolError("rubbish", device="shaker")

    with pytest.raises(ProtocolError, match="rubbish"):
        await line.call(fail, 60.0)
    line.close()


async def test_a_call_that_hangs_is_given_up_and_the_next_one_works():
    line, release = ThreadExecutor("camera"), threading.Event()
    with pytest.raises(TransportError, match=r"camera: did not answer within 0\.05 s"):
        await line.call(release.wait, 0.05)
    assert await line.call(lambda: "well", 60.0) == "well"
    release.set()
    line.close()


async def test_an_urgent_call_goes_past_a_busy_device():
    line, release = ThreadExecutor("shaker"), threading.Event()
    busy = asyncio.create_task(line.call(release.wait, 120.0))
    await asyncio.sleep(0)
    began = time.monotonic()
    assert await line.urgent(lambda: "stopped", 60.0) == "stopped"
    assert time.monotonic() - began < 60.0
    release.set()
    assert await busy
    line.close()


async def test_a_device_in_which_too_much_hangs_is_refused_until_it_lets_go():
    line, release = ThreadExecutor("camera"), threading.Event()
    for _ in range(MAX_STUCK):
        with pytest.raises(TransportError, match="did not answer"):
            await line.call(release.wait, 0.01)
    with pytest.raises(TransportError, match="power-cycle"):
        await line.call(lambda: None, 1.0)
    release.set()
    for _ in range(200):
        try:
            assert await line.call(lambda: "well", 60.0) == "well"
            break
        except TransportError:
            await asyncio.sleep(0.01)
    else:
        pytest.fail("it was never well again")
    line.close()


async def test_a_system_without_threads_is_a_device_that_cannot_be_called(monkeypatch: pytest.MonkeyPatch):
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    line = ThreadExecutor("shaker")
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", refuse)
        with pytest.raises(TransportError, match="shaker: cannot be called: the system has no thread left"):
            await line.urgent(lambda: None, 60.0)
    assert await line.urgent(lambda: "stopped", 60.0) == "stopped"  # as soon as there is one again
    line.close()


def test_the_inline_line_lets_the_time_pass_that_a_call_takes():
    clock = SimulatedClock()

    async def main() -> None:
        spent = [2.5]
        line = InlineExecutor("gauge", lambda: spent[0])
        assert await line.call(lambda: 7, 10.0) == 7
        assert clock.monotonic() == 2.5
        spent[0] = float("inf")
        with pytest.raises(TransportError, match="gauge: did not answer within 10 s"):
            await line.call(lambda: 7, 10.0)
        assert clock.monotonic() == 12.5

    clock.run(main())
