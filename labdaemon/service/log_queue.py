"""Log records on their way out: a bounded queue and one thread, so that no record ever waits for its reader.

A terminal that a person has stopped, a pipe that is not read, a full disk and a stalled systemd journal all make a
write wait. The event loop and the threads that stop the table must not: they only put records into the queue. What
finds the queue full is dropped and counted, and the count is itself a record as soon as there is room again.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable

QUEUE_RECORDS = 1000
"""Records that wait for a slow reader; a night's burst of faults fits."""
LONGEST_TEXT = 16_384
"""Characters of one record's message or exception; what is longer is cut."""
CLOSE_S = 0.5
"""How long the end of the process waits for the records that are still queued."""


class LogQueueHandler(logging.Handler):
    """A handler that never waits: `write` is called with each record on a thread of its own.

    Parameters
    ----------
    write
        Writes one record; it may wait, and what it raises is counted as a dropped record.
    capacity
        Records that may wait.
    close_writer
        Gives back what `write` holds; called on the same thread after the last record.

    Attributes
    ----------
    dropped
        Records that were never written.
    """

    def __init__(
        self,
        write: Callable[[logging.LogRecord], None],
        capacity: int = QUEUE_RECORDS,
        close_writer: Callable[[], None] | None = None,
    ) -> None:
        super().__init__()
        self._write = write
        self._close_writer = close_writer
        self._queue: queue.Queue[logging.LogRecord | None] = queue.Queue(capacity)
        self._idle = threading.Event()
        self.dropped: int = 0
        self._reported = 0
        self._is_closed = False
        # A daemon thread: a reader that never reads must not hold up the end of the process either.
        threading.Thread(target=self._run, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record, or count it as dropped."""
        try:
            self._queue.put_nowait(_frozen(record))
        except queue.Full:
            self.dropped += 1
        except Exception:
            # A message that cannot be formatted is a slip of ours; it must not end what wanted to log it.
            self.dropped += 1

    def close(self) -> None:
        """Write what is queued, for at most half a second, and end the thread."""
        if not self._is_closed:
            self._is_closed = True
            try:
                self._queue.put_nowait(None)
            except queue.Full:
                pass  # the reader does not read: nothing more is written
            else:
                self._idle.wait(CLOSE_S)
        super().close()

    def flush(self) -> None:
        """Wait until everything queued so far is written, for at most half a second."""
        end = time.monotonic() + CLOSE_S
        while self._queue.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.005)

    def _run(self) -> None:
        while (record := self._queue.get()) is not None:
            self._write_counted(record)
            if self.dropped > self._reported and self._queue.empty():
                self._report_dropped()
            self._queue.task_done()
        if self._close_writer is not None:
            self._close_writer()
        self._queue.task_done()
        self._idle.set()

    def _write_counted(self, record: logging.LogRecord) -> None:
        try:
            self._write(record)
        except Exception:
            # The reader is gone, the disk is full: there is nowhere to report it but the count.
            self.dropped += 1

    def _report_dropped(self) -> None:
        """One record for all that were dropped since the last one."""
        count = self.dropped
        text = f"{count - self._reported} log records were dropped: their reader did not read ({count} in all)"
        before = self.dropped
        self._write_counted(logging.LogRecord(__name__, logging.WARNING, __file__, 0, text, (), None))
        if self.dropped == before:
            self._reported = count


def _frozen(record: logging.LogRecord) -> logging.LogRecord:
    """A copy whose texts are made now, by the thread that logs: its arguments may change later."""
    copy = logging.makeLogRecord(record.__dict__)
    copy.msg, copy.args = _bounded(record.getMessage()), None
    if record.exc_info and not record.exc_text:
        copy.exc_text = _bounded(logging.Formatter().formatException(record.exc_info))
    copy.exc_info = None
    return copy


def _bounded(text: str) -> str:
    """Text that any encoding takes, of bounded length."""
    text = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]} (cut from {len(text)} characters)"
