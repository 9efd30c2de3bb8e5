"""Worker processes that measure frames: started clean, given paths rather than pixels, expected to die at any time.

A task that kills its worker, or outstays its deadline, is tried once more in a new pool; after that the input
is at fault and the caller gets a `DataError`. Tasks that shared the broken pool are simply run again.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.forkserver
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import ParamSpec, TypeVar

from labdaemon.errors import DataError, LabdaemonError

P = ParamSpec("P")
R = TypeVar("R")

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""One core a worker: numpy, OpenCV and LibRaw each bring threads of their own, which only fight for the cores."""

POLL_S = 0.5
"""How often a running task's time is looked at."""

IDLE_SHARE = 0.1
"""Share of the time that counts for a task whose workers compute nothing: other programs may have the cores, or a disk
may be slow. One that never computes is given up after ten times its deadline."""


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _start_worker(pids: SimpleQueue[int]) -> None:
    """First thing a worker does. Ctrl-C reaches the whole process group; what to do about it is the parent's affair."""
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(ONE_THREAD)
    cv2.setNumThreads(1)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    pids.put(os.getpid())


def _end_with_parent() -> None:
    """End this worker when its parent is gone: a killed parent cannot end it, and its queue does not report it.

    Workers hold both ends of the pipe that they wait on, and keep their fork server alive; without this every kill -9
    of the daemon would leave a pool behind.
    """
    parent = multiprocessing.parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)


class _WorkerLost(Exception):
    """A task's worker died or outstayed its deadline; the text says which."""


class _WorkClock:
    """Time that a task had to work: the computing time of the busiest worker, not the time on the wall.

    A machine that is busy with other programs gives workers a part of its cores only, and no task is to blame for that.
    The clock never runs slower than the task's own worker computes, and never faster than the wall's.
    """

    def __init__(self) -> None:
        self._at = time.monotonic()
        self._seen: dict[int, float] = {}
        self.elapsed_s = 0.0

    def advance(self, pids: set[int]) -> None:
        """Count the time since the last call, with the workers of now."""
        now, seen = time.monotonic(), {pid: _computing_time_s(pid) for pid in pids}
        wall = now - self._at
        known = {pid: used for pid, used in seen.items() if used is not None}
        # Without the system's record of a process all time counts.
        computed = max((used - self._seen.get(pid, used) for pid, used in known.items()), default=wall)
        self.elapsed_s += min(max(computed, IDLE_SHARE * wall), wall)
        self._at, self._seen = now, known


def _computing_time_s(pid: int) -> float | None:
    """Processor time of a process, of all its threads; None where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None


class _Generation:
    """One set of worker processes, from its start until it breaks or is closed."""

    def __init__(self, workers: int) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["labdaemon.processing"])
        with _environment(ONE_THREAD):
            multiprocessing.forkserver.ensure_running()
        self._started: SimpleQueue[int] = context.SimpleQueue()
        self._pids: set[int] = set()
        self._lock = threading.Lock()
        self.executor = ProcessPoolExecutor(workers, context, _start_worker, (self._started,))

    def run(self, function: Callable[P, R], deadline_s: float, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run one task to its end, its own exception, or `_WorkerLost`."""
        try:
            future = self.executor.submit(function, *args, **kwargs)
        except RuntimeError as exc:  # broken or shut down by a neighbour since it was picked
            raise _WorkerLost("lost its worker process") from exc
        clock = _WorkClock()
        try:
            while not wait([future], POLL_S).done:
                clock.advance(self._workers())
                if clock.elapsed_s > deadline_s:
                    raise _WorkerLost(f"took longer than {deadline_s:g} s")
            return future.result()
        except (BrokenProcessPool, CancelledError) as exc:
            raise _WorkerLost("killed its worker process") from exc

    def _workers(self) -> set[int]:
        """Processes of the workers that have started."""
        with self._lock:
            while not self._started.empty():
                self._pids.add(self._started.get())
            return set(self._pids)

    def kill(self) -> None:
        """Kill every worker: the executor then fails all that is pending with `BrokenProcessPool`."""
        for pid in self._workers():
            with contextlib.suppress(ProcessLookupError):  # it has died already, perhaps of its memory
                os.kill(pid, signal.SIGKILL)
        self.executor.shutdown(wait=False, cancel_futures=True)


class WorkerPool:
    """A pool of worker processes that outlives its workers.

    Parameters
    ----------
    workers
        Number of processes; 0 for one a core.
    deadline_s
        How long a task may compute once it has begun, before its workers are killed. Time in which its workers do not
        get to compute counts by a tenth.
    """

    def __init__(self, workers: int = 0, *, deadline_s: float = 300.0) -> None:
        self.workers: int = workers or len(os.sched_getaffinity(0))
        self.deadline_s = deadline_s
        self._lock = threading.Lock()
        self._generation: _Generation | None = None
        self._closed = False
        # One thread waits for each task in flight, so no task ever queues inside the executor with its clock running.
        self._waiters = ThreadPoolExecutor(self.workers, thread_name_prefix="pool")

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def submit(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run a module-level function on picklable arguments in a worker.

        Returns
        -------
        Future
            Its result, or the exception it raised; `DataError` if it took its worker with it, or overran its
            deadline, twice.
        """
        return self._waiters.submit(lambda: self._run(function, *args, **kwargs))

    def close(self) -> None:
        """Kill the workers and wait for the waiting threads."""
        with self._lock:
            self._closed = True
            generation, self._generation = self._generation, None
        if generation is not None:
            generation.kill()
        self._waiters.shutdown(wait=True, cancel_futures=True)

    def _current(self) -> _Generation:
        with self._lock:
            if self._closed:
                raise LabdaemonError("the worker pool is closed")
            if self._generation is None:
                self._generation = _Generation(self.workers)
            return self._generation

    def _retire(self, generation: _Generation) -> None:
        with self._lock:
            if self._generation is generation:
                self._generation = None
        generation.kill()

    def _run(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        generation = self._current()
        try:
            return generation.run(function, self.deadline_s, *args, **kwargs)
        except _WorkerLost:
            self._retire(generation)
        if self._closed:
            raise LabdaemonError("the worker pool is closed")
        # The second attempt runs alone, so that a task is never blamed for what a neighbour did to the pool.
        alone = _Generation(1)
        try:
            return alone.run(function, self.deadline_s, *args, **kwargs)
        except _WorkerLost as exc:
            name = getattr(function, "__name__", "task")
            raise DataError(f"{name} {exc} twice; the input is at fault: {_describe(args)}") from None
        finally:
            alone.kill()


def _describe(args: tuple[object, ...]) -> str:
    paths = [str(arg) for arg in args if isinstance(arg, (os.PathLike, str))]
    return ", ".join(paths) or "see the log"
