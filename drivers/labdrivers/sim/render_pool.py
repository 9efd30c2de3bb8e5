"""Renders in other processes than the simulation's: a frame takes seconds of arithmetic and must not stop the wires.

Workers are plain child processes fed through pipes (``python -m labdrivers.sim.render_pool``), so they import nothing
of the program that uses them, and end by themselves when it is gone, however it went.
"""

from __future__ import annotations

import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
from typing import IO

from labdrivers.sim.rig import ExposureJob, render_job

SMALL_PIXELS = 100_000
"""Frames up to this are rendered at once, in the caller's thread."""


class RenderPool:
    """Worker processes, started when first needed.

    Parameters
    ----------
    workers
        How many frames at a time.
    """

    def __init__(self, workers: int = 2) -> None:
        self._idle: queue.SimpleQueue[subprocess.Popen[bytes] | None] = queue.SimpleQueue()
        for _ in range(workers):
            self._idle.put(None)
        self._all: list[subprocess.Popen[bytes]] = []
        self._closed = threading.Event()

    def render(self, job: ExposureJob) -> bytes:
        """The job's file; waits for it. A worker that dies costs its time, not the frame."""
        width, height = job.spec.cameras[job.camera].image_size
        if width * height <= SMALL_PIXELS or self._closed.is_set():
            return render_job(job)
        worker = self._idle.get()
        try:
            if worker is None or worker.poll() is not None:
                worker = self._start()
            assert worker.stdin is not None
            assert worker.stdout is not None
            _write(worker.stdin, pickle.dumps(job))
            return _read(worker.stdout)
        except (OSError, EOFError):
            return render_job(job)
        finally:
            self._idle.put(worker)

    def close(self) -> None:
        """End the workers."""
        self._closed.set()
        for worker in self._all:
            worker.terminate()
            worker.wait()
            for pipe in (worker.stdin, worker.stdout):
                if pipe is not None:
                    pipe.close()

    def _start(self) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        worker = subprocess.Popen(
            [sys.executable, "-m", "labdrivers.sim.render_pool"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # a Ctrl-C at the terminal is for the program, which then closes this
        )
        self._all.append(worker)
        return worker


def _write(pipe: IO[bytes], data: bytes) -> None:
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def _read(pipe: IO[bytes]) -> bytes:
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError("renderer is gone")
    (size,) = struct.unpack("<Q", head)
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError("renderer is gone")
    return data


def serve(jobs: IO[bytes], files: IO[bytes]) -> None:
    """Render what comes until nothing more does. The jobs are this program's own, from its parent's pipe."""
    while True:
        try:
            job = pickle.loads(_read(jobs))
        except EOFError:
            return
        _write(files, render_job(job))


if __name__ == "__main__":
    serve(sys.stdin.buffer, sys.stdout.buffer)
