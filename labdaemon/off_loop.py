"""Blocking work off the event loop, on threads that hold up nothing, not even the end of the process.

`asyncio.to_thread` shares a pool whose threads the interpreter waits for at its end: six slow jobs of one peer would
block results and SIGTERM.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


async def off_loop(function: Callable[[*Ts], T], *arguments: *Ts) -> T:
    """Call a blocking function on a thread of its own and wait for what it returns.

    A caller that is cancelled waits no longer; the thread ends when the function does, or with the process.

    Raises
    ------
    Exception
        Whatever the function raises.
    RuntimeError
        The system has no thread left.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()
    work = (function, arguments, loop, future)
    threading.Thread(target=_run, args=work, name="off-loop", daemon=True).start()
    del work
    try:
        return await future
    finally:
        # An error holds this frame, and the future holds the error: a circle that would keep a peer's megabyte in
        # memory until the next full collection, which in a large process is rare.
        del future


def _run(
    function: Callable[[*Ts], T], arguments: tuple[*Ts], loop: asyncio.AbstractEventLoop, future: asyncio.Future[T]
) -> None:
    result: T | None = None
    error: BaseException | None = None
    try:
        result = function(*arguments)
    except (StopIteration, KeyboardInterrupt, SystemExit, asyncio.CancelledError) as exc:
        # A future does not take the first; the others would end the loop or look like a cancelled caller.
        error = RuntimeError(f"{type(exc).__name__} in {getattr(function, '__name__', function)}")
    except BaseException as exc:
        error = exc
    try:
        loop.call_soon_threadsafe(_settle, future, result, error)
    except RuntimeError:
        return  # the loop has closed: its caller is gone
    finally:
        del error, future, arguments  # the error's traceback holds this frame


def _settle(future: asyncio.Future[T], result: T | None, error: BaseException | None) -> None:
    if future.done():
        return
    if error is not None:
        future.set_exception(error)
    else:
        future.set_result(result)  # type: ignore[arg-type]
