"""The pool with real worker processes: functions here are imported by the workers."""

from __future__ import annotations

import concurrent.futures
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from labdaemon.errors import DataError, LabdaemonError
from labdaemon.processing.pool import WorkerPool
from labdaemon.processing.tables import csv_text


def compute(seconds: float) -> float:
    """Use a core for so long; a worker's task."""
    begun = time.process_time()
    while time.process_time() - begun < seconds:
        pass
    return time.process_time() - begun


def test_runs_a_function_and_passes_its_exception(pool: WorkerPool) -> None:
    assert pool.submit(csv_text, ["a"], [{"a": 1.5}]).result(300) == "a\n1.500000\n"
    with pytest.raises(KeyError):
        pool.submit(csv_text, ["a"], [{}]).result(300)


@pytest.fixture(scope="module")
def pool():
    with WorkerPool(2, deadline_s=60) as it:
        yield it


def test_workers_keep_to_one_thread_and_leave_ctrl_c_to_the_parent(pool: WorkerPool) -> None:
    assert pool.submit(os.getenv, "OMP_NUM_THREADS").result(300) == "1"
    assert pool.submit(signal.getsignal, signal.SIGINT).result(300) == signal.SIG_IGN
    assert pool.submit(os.getpid).result(300) != os.getpid()


def test_a_poisoned_task_is_refused_and_its_neighbours_survive(pool: WorkerPool) -> None:
    others = [pool.submit(time.sleep, 0.2) for _ in range(3)]
    poison = pool.submit(os._exit, 3)
    with pytest.raises(DataError, match=r"_exit killed its worker process twice"):
        poison.result(300)
    for other in others:
        other.result(300)
    assert pool.submit(os.getenv, "OMP_NUM_THREADS").result(300) == "1"


def test_a_worker_killed_from_outside_costs_nothing(pool: WorkerPool, tmp_path: Path) -> None:
    marker = tmp_path / "once"
    task = pool.submit(os.path.exists, marker)
    task.result(300)
    pid = pool.submit(os.getpid).result(300)
    slow = pool.submit(time.sleep, 0.5)
    os.kill(pid, signal.SIGKILL)
    assert slow.result(300) is None


def test_a_task_that_never_ends_is_given_up() -> None:
    with WorkerPool(1, deadline_s=1.5) as pool, pytest.raises(DataError, match=r"longer than 1.5 s twice"):
        pool.submit(compute, math.inf).result(300)


def test_a_task_that_waits_for_ever_is_given_up_later() -> None:
    with WorkerPool(1, deadline_s=0.1) as pool, pytest.raises(DataError, match=r"longer than 0.1 s twice"):
        pool.submit(time.sleep, 600).result(300)


def test_time_without_a_core_is_not_held_against_a_task() -> None:
    """A worker that is stopped for longer than its deadline, as by a busy machine, finishes its task."""
    with WorkerPool(1, deadline_s=4.0) as pool:
        pid = pool.submit(os.getpid).result(300)
        task = pool.submit(compute, 0.1)
        os.kill(pid, signal.SIGSTOP)
        done, _ = concurrent.futures.wait([task], 5.0)
        assert not done
        os.kill(pid, signal.SIGCONT)
        assert task.result(300) >= 0.1
        assert pool.submit(os.getpid).result(300) == pid  # and no second worker had to do it


def test_closing_ends_what_is_running() -> None:
    pool = WorkerPool(1, deadline_s=600)
    pool.submit(os.getpid).result(300)
    slow = pool.submit(time.sleep, 600)
    threading.Timer(0.3, pool.close).start()
    with pytest.raises(LabdaemonError, match="closed"):
        slow.result(300)


def test_workers_end_with_a_killed_parent() -> None:
    script = (
        "import os, sys\n"
        "from labdaemon.processing.pool import WorkerPool\n"
        "if __name__ == '__main__':\n"
        "    pool = WorkerPool(2)\n"
        "    pids = {pool.submit(os.getpid).result() for _ in range(8)}\n"
        "    print(pool.submit(os.getppid).result(), *pids, flush=True)\n"
        "    sys.stdin.read()\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert parent.stdin is not None
    assert parent.stdout is not None
    with parent.stdin, parent.stdout:
        children = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(children) >= 2  # the fork server and a worker or more
        handles = [os.pidfd_open(pid) for pid in children]
        parent.kill()
        parent.wait()
        try:
            for handle in handles:
                assert select.select([handle], [], [], 120.0)[0], "a worker outlived its parent"
        finally:
            for handle in handles:
                os.close(handle)
