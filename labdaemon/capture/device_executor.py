"""One thread a device: its blocking calls wait there, with a deadline, and never hold up the event loop.

A call that outlasts its deadline is given up: its thread is abandoned (Python cannot stop it) and the next call gets a
new one. Urgent calls, a hard stop above all, go past whatever the device is busy with, and questions that only watch it
have a thread of their own too; drivers take them from any thread at any time.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import Literal, Protocol, TypeVar

from labdaemon.errors import TransportError

T = TypeVar("T")

Lane = Literal["call", "urgent", "observe"]

MAX_STUCK = 8
"""Threads that may hang in one device's driver at a time before no more calls are made."""


class DeviceExecutor(Protocol):
    """How a device's blocking calls are made from the event loop."""

    async def call(self, function: Callable[[], T], timeout_s: float) -> T:
        """Call it after the device's earlier calls; `TransportError` when it has not returned in time."""
        ...

    async def urgent(self, function: Callable[[], T], timeout_s: float) -> T:
        """Call it now, whatever the device is busy with."""
        ...

    async def observe(self, function: Callable[[], T], timeout_s: float) -> T:
        """Ask meanwhile, in turn with other such questions only: a stop never waits behind one."""
        ...

    def close(self) -> None:
        """Let the thread end."""
        ...


class _Worker:
    """A thread that makes calls one after the other."""

    def __init__(self, name: str) -> None:
        self.is_busy = False
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def put(self, call: Callable[[], None] | None) -> None:
        self._calls.put(call)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            self.is_busy = True
            call()
            self.is_busy = False


class ThreadExecutor:
    """A device's own thread.

    Parameters
    ----------
    device
        Its name, for messages.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        self._workers: dict[Lane, _Worker] = {}
        self._abandoned: list[_Worker] = []

    async def call(self, function: Callable[[], T], timeout_s: float) -> T:
        return await self._call("call", function, timeout_s)

    async def urgent(self, function: Callable[[], T], timeout_s: float) -> T:
        return await self._call("urgent", function, timeout_s)

    async def observe(self, function: Callable[[], T], timeout_s: float) -> T:
        return await self._call("observe", function, timeout_s)

    def close(self) -> None:
        for worker in self._workers.values():
            worker.put(None)
        self._workers.clear()

    async def _call(self, lane: Lane, function: Callable[[], T], timeout_s: float) -> T:
        worker = self._workers.get(lane)
        if worker is None:
            name = self._device if lane == "call" else f"{self._device} ({lane})"
            try:
                worker = self._workers[lane] = _Worker(name)
            except RuntimeError as exc:
                raise TransportError(
                    f"cannot be called: the system has no thread left ({exc}); end other programs or raise their limit",
                    device=self._device,
                ) from exc
        try:
            return await self._wait(worker, function, timeout_s)
        except TimeoutError:
            if self._workers.get(lane) is worker:
                del self._workers[lane]
            raise self._give_up(worker, timeout_s) from None

    async def _wait(self, worker: _Worker, function: Callable[[], T], timeout_s: float) -> T:
        self._abandoned = [worker for worker in self._abandoned if worker.is_busy]
        if len(self._abandoned) >= MAX_STUCK:
            raise TransportError(f"{MAX_STUCK} calls hang in it; power-cycle it", device=self._device)
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def settle(result: T | None, error: BaseException | None) -> None:
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)  # type: ignore[arg-type]

        def run() -> None:
            result, error = None, None
            try:
                result = function()
            except Exception as exc:
                # A future takes no StopIteration: the call would then never end.
                error = RuntimeError("StopIteration") if isinstance(exc, StopIteration) else exc
            except BaseException as exc:  # sys.exit() in a driver ends its call, not the daemon
                error = RuntimeError(f"{type(exc).__name__}: {exc}")
            try:
                loop.call_soon_threadsafe(settle, result, error)
            except RuntimeError:
                return  # the loop has closed: no caller waits any more

        worker.put(run)
        async with asyncio.timeout(timeout_s):
            return await future

    def _give_up(self, worker: _Worker, timeout_s: float) -> TransportError:
        self._abandoned.append(worker)
        worker.put(None)
        return TransportError(f"did not answer within {timeout_s:g} s; check its cable and power", device=self._device)


class InlineExecutor:
    """For simulated time: makes the call at once and lets the time pass that the device says it took.

    Parameters
    ----------
    device
        Its name, for messages.
    spent_s
        Seconds that the last call took, asked right after it; infinite for one that never answers.
    """

    def __init__(self, device: str, spent_s: Callable[[], float]) -> None:
        self._device, self._spent_s = device, spent_s
        self._turn = asyncio.Lock()

    async def call(self, function: Callable[[], T], timeout_s: float) -> T:
        async with self._turn:
            return await self.urgent(function, timeout_s)

    async def urgent(self, function: Callable[[], T], timeout_s: float) -> T:
        result, error = None, None
        try:
            result = function()
        except Exception as exc:
            error = exc
        spent_s = self._spent_s()
        if spent_s:
            await asyncio.sleep(min(spent_s, timeout_s))
        if spent_s > timeout_s:
            raise TransportError(f"did not answer within {timeout_s:g} s", device=self._device)
        if error is not None:
            raise error
        return result  # type: ignore[return-value]

    async def observe(self, function: Callable[[], T], timeout_s: float) -> T:
        return await self.urgent(function, timeout_s)

    def close(self) -> None:
        """Nothing to end."""
