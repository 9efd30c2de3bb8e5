"""Runs `labdaemon` commands one after the other in one process, and reports how each ended.

``python -m labdaemon.bench.world.fuzz_child`` reads a JSON list of arguments a line and answers each with a line of
JSON: ``status``, ``stderr``, ``seconds`` of CPU, ``memory_mb`` (the most of any process so far). A command that takes
too long by the clock is interrupted and has the status "hang".
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import sys
import traceback
from importlib.metadata import entry_points

HANG_S = 60.0
"""On a machine that does nothing else ten would do; CPU time is what is judged."""


WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


class Hang(BaseException):
    """The command took too long."""


def main() -> None:
    """Serve until standard input ends."""
    [command] = entry_points(group="console_scripts", name="labdaemon")
    labdaemon = command.load()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries in C print, too
    signal.signal(signal.SIGALRM, _interrupt)
    for line in sys.stdin:
        sys.argv = ["labdaemon", *json.loads(line)]
        out, err = io.StringIO(), io.StringIO()
        status: int | str | None = None
        began_s = _cpu_s()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                signal.setitimer(signal.ITIMER_REAL, HANG_S)
                labdaemon()
            except SystemExit as exc:
                status = exc.code
            except Hang:
                status = "hang"
            except BaseException:
                status = "traceback"
                traceback.print_exc()
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
        report = {
            "status": status or 0,
            "stderr": err.getvalue()[-4000:],
            "seconds": _cpu_s() - began_s,
            "memory_mb": max(resource.getrusage(who).ru_maxrss for who in WHO) / 1024.0,
        }
        answers.write(json.dumps(report) + "\n")
        answers.flush()


def _cpu_s() -> float:
    """CPU seconds of this process and of those that it has started and that have ended."""
    used = [resource.getrusage(who) for who in WHO]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _interrupt(*_: object) -> None:
    raise Hang


if __name__ == "__main__":
    main()
