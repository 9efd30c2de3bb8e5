"""Where the guardian reports what it did: standard error, the system's log, and a file that the next daemon reads.

Everything is written by a thread: a reader that has stopped reading must not hold up a stop.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
import time
from contextlib import suppress
from typing import Any

LONGEST_WAIT_S = 2.0
"""Longest that the end of the process waits for its last words to be written."""


class RescueReporter:
    """Writes reports.

    Parameters
    ----------
    rig
        Name of the shaker's rig, for the messages.
    file
        Where the outcome is left for the next daemon; None for nowhere.
    """

    def __init__(self, rig: str, file: str | None) -> None:
        self._rig, self._file = rig, file
        self._queue: queue.SimpleQueue[tuple[str, dict[str, Any] | None]] = queue.SimpleQueue()
        self._written = threading.Event()
        threading.Thread(target=self._write_all, name="reports", daemon=True).start()

    def say(self, text: str) -> None:
        """Put a line into the logs."""
        self._queue.put((text, None))

    def conclude(self, text: str, outcome: dict[str, Any]) -> None:
        """Put the last line into the logs, leave the outcome, and wait a moment for both to be written."""
        self._queue.put((text, outcome))
        self._written.wait(LONGEST_WAIT_S)

    def _write_all(self) -> None:
        while True:
            text, outcome = self._queue.get()
            if outcome is not None and self._file is not None:
                self._leave(outcome)
            self._log(text)
            if outcome is not None:
                self._written.set()

    def _log(self, text: str) -> None:
        line = f"labdaemon guardian ({self._rig}): {text}"
        with suppress(OSError):  # the terminal has gone; the system's log has it
            os.write(2, line.encode(errors="replace") + b"\n")
        if "JOURNAL_STREAM" not in os.environ:  # there standard error is the system's log
            import syslog

            syslog.openlog("labdaemon-guardian", syslog.LOG_PID, syslog.LOG_DAEMON)
            syslog.syslog(syslog.LOG_CRIT, text)

    def _leave(self, outcome: dict[str, Any]) -> None:
        assert self._file is not None
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        part = f"{self._file}.part"
        try:
            with open(part, "w", encoding="utf-8") as file:
                json.dump({"at": at, **outcome}, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, self._file)
        except OSError as exc:
            print(f"labdaemon guardian: {self._file} cannot be written ({exc})", file=sys.stderr)
