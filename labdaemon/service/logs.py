"""Structured logs: fields to the systemd journal, JSON lines to a pipe, plain lines to a terminal."""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
from datetime import UTC, datetime

from labdaemon.clock import rfc3339

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
    if record.exc_info:
        fields["EXCEPTION"] = logging.Formatter().formatException(record.exc_info)
    return fields


def encode_fields(fields: dict[str, str]) -> bytes:
    """The journal's native protocol: ``NAME=value`` lines; a value with newlines goes by its length (u64)."""
    parts: list[bytes] = []
    for name, value in fields.items():
        data = value.encode()
        if b"\n" in data:
            parts.append(name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n")
        else:
            parts.append(name.encode() + b"=" + data + b"\n")
    return b"".join(parts)


class JournalHandler(logging.Handler):
    """Sends records to the systemd journal with their fields."""

    def __init__(self, address: str = JOURNAL_SOCKET) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.connect(address)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._socket.send(encode_fields(fields_of(record)))
        except OSError:
            self.handleError(record)

    def close(self) -> None:
        self._socket.close()
        super().close()


class JsonFormatter(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "at": rfc3339(datetime.fromtimestamp(record.created, UTC)),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line)


def set_up_logs(level: int = logging.INFO) -> None:
    """Send the daemon's log to where it is read."""
    handler: logging.Handler
    if os.environ.get("JOURNAL_STREAM") and os.path.exists(JOURNAL_SOCKET):
        handler = JournalHandler()
    else:
        handler = logging.StreamHandler(sys.stderr)
        if sys.stderr.isatty():
            handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
        else:
            handler.setFormatter(JsonFormatter())
    root = logging.getLogger("labdaemon")
    root.handlers[:] = [handler]
    root.setLevel(level)
