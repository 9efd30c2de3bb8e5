"""Structured logs: fields to the systemd journal, JSON lines to a pipe, plain lines to a terminal.

None of them is waited for by whoever logs (`labdaemon.service.log_queue`).
"""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
import threading
from datetime import UTC, datetime

from labdaemon.clock import rfc3339
from labdaemon.service.log_queue import LogQueueHandler

JOURNAL_SOCKET = "/run/systemd/journal/socket"
PRIORITIES = {logging.DEBUG: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}


def fields_of(record: logging.LogRecord) -> dict[str, str]:
    """A record as the systemd journal names its parts."""
    fields = {
        "MESSAGE": record.getMessage(),
        "PRIORITY": str(PRIORITIES.get(record.levelno, 6)),
        "SYSLOG_IDENTIFIER": "labdaemon",
        "LOGGER": record.name,
        "CODE_FILE": record.pathname,
        "CODE_LINE": str(record.lineno),
        "CODE_FUNC": record.funcName or "",
    }
    if exception := exception_of(record):
        fields["EXCEPTION"] = exception
    return fields


def exception_of(record: logging.LogRecord) -> str:
    """Traceback of a record, empty if it has none."""
    if record.exc_text or not record.exc_info:
        return record.exc_text or ""
    return logging.Formatter().formatException(record.exc_info)


def encode_fields(fields: dict[str, str]) -> bytes:
    """The journal's native protocol: ``NAME=value`` lines; a value with newlines goes by its length (u64)."""
    parts: list[bytes] = []
    for name, value in fields.items():
        data = value.encode("utf-8", "backslashreplace")
        if b"\n" in data:
            parts.append(name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n")
        else:
            parts.append(name.encode() + b"=" + data + b"\n")
    return b"".join(parts)


class JournalWriter:
    """Sends records to the systemd journal with their fields.

    Parameters
    ----------
    address
        Of the journal's socket.

    Raises
    ------
    OSError
        The socket cannot be reached.
    """

    def __init__(self, address: str = JOURNAL_SOCKET) -> None:
        self._address = address
        self._socket = self._connected()

    def __call__(self, record: logging.LogRecord) -> None:
        """Send a record. May wait for the journal; connects anew where the journal was started again."""
        data = encode_fields(fields_of(record))
        try:
            self._socket.send(data)
        except (ConnectionError, FileNotFoundError):
            self.close()
            self._socket = self._connected()
            self._socket.send(data)

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def _connected(self) -> socket.socket:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            sock.connect(self._address)
        except OSError:
            sock.close()
            raise
        return sock


class JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "at": rfc3339(datetime.fromtimestamp(record.created, UTC)),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if exception := exception_of(record):
            line["exception"] = exception
        return json.dumps(line)


class StreamWriter:
    """Writes records as lines to a file descriptor; may wait for its reader.

    Parameters
    ----------
    descriptor
        Of stderr, most likely. It is written to directly: `sys.stderr` has a lock, and whoever prints there would wait
        for a reader together with this thread.
    formatter
        Makes the line.
    """

    def __init__(self, descriptor: int, formatter: logging.Formatter) -> None:
        self._descriptor, self._formatter = descriptor, formatter

    def __call__(self, record: logging.LogRecord) -> None:
        """Write a record's line whole."""
        data = memoryview(f"{self._formatter.format(record)}\n".encode("utf-8", "backslashreplace"))
        while data:
            data = data[os.write(self._descriptor, data) :]

    def close(self) -> None:
        """Leave the descriptor open: it is the process's own."""


def set_up_logs(level: int = logging.INFO) -> None:
    """Send the log of the daemon and of its libraries to where it is read.

    Warnings, and exceptions that end a thread, go the same way: Python would write them to stderr and wait.
    """
    root = logging.getLogger()
    for handler in root.handlers:
        handler.close()
    writer = _writer()
    root.handlers[:] = [LogQueueHandler(writer, close_writer=writer.close)]
    logging.getLogger("labdaemon").setLevel(level)
    logging.captureWarnings(True)
    threading.excepthook = _log_thread_end


def _log_thread_end(ended: threading.ExceptHookArgs) -> None:
    if ended.exc_value is not None:
        name = ended.thread.name if ended.thread is not None else "of no name"
        logging.getLogger(__name__).error("thread %s ended", name, exc_info=ended.exc_value)


def _writer() -> JournalWriter | StreamWriter:
    if os.environ.get("JOURNAL_STREAM") and os.path.exists(JOURNAL_SOCKET):
        try:
            return JournalWriter()
        except OSError:
            pass  # no journal after all: stderr is read by something else then
    formatter: logging.Formatter = JsonFormatter()
    if sys.stderr.isatty():
        formatter = logging.Formatter("%(asctime)s %(levelname)s %(message)s")
    return StreamWriter(sys.stderr.fileno(), formatter)
