from __future__ import annotations

import json
import logging
import socket
from pathlib import Path

from labdaemon.service.logs import JournalWriter, JsonFormatter, encode_fields


def record(message: str, *, failed: bool = False) -> logging.LogRecord:
    info = None
    if failed:
        try:
            raise ValueError("no good")
        except ValueError as exc:
            info = (type(exc), exc, exc.__traceback__)
    return logging.LogRecord("labdaemon.test", logging.WARNING, "file.py", 7, message, (), info)


def test_a_line_is_one_json_object():
    line = JsonFormatter().format(record("two\nlines", failed=True))
    assert "\n" not in line
    told = json.loads(line)
    assert (told["level"], told["logger"], told["message"]) == ("warning", "labdaemon.test", "two\nlines")
    assert "ValueError: no good" in told["exception"]
    assert told["at"].endswith("Z")


def test_fields_are_encoded_as_the_journal_reads_them():
    assert encode_fields({"A": "b"}) == b"A=b\n"
    assert encode_fields({"A": "b\nc"}) == b"A\n\x03\x00\x00\x00\x00\x00\x00\x00b\nc\n"


def test_records_reach_the_journal_with_their_fields(tmp_path: Path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "socket"))
        writer = JournalWriter(str(tmp_path / "socket"))
        writer(record("it is warm"))
        sent = server.recv(10_000).split(b"\n")
        writer.close()
    assert b"MESSAGE=it is warm" in sent
    assert b"PRIORITY=4" in sent
    assert b"SYSLOG_IDENTIFIER=labdaemon" in sent
    assert b"CODE_LINE=7" in sent
