"""Log records never wait: a reader that does not read costs records, which are counted, and nothing else."""

from __future__ import annotations

import json
import logging
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.service.log_queue import LONGEST_TEXT, LogQueueHandler
from labdaemon.service.logs import JournalWriter, JsonFormatter, StreamWriter


def record(message: str, *values: object) -> logging.LogRecord:
    return logging.LogRecord("labdaemon.test", logging.WARNING, "file.py", 7, message, values, None)


@pytest.fixture
def stuck() -> Iterator[tuple[LogQueueHandler, list[str], threading.Event]]:
    """A handler whose reader reads only once the event is set."""
    written: list[str] = []
    reads = threading.Event()

    def write(one: logging.LogRecord) -> None:
        reads.wait(60)
        written.append(one.getMessage())

    handler = LogQueueHandler(write, capacity=3)
    yield handler, written, reads
    reads.set()
    handler.close()


def test_records_that_find_no_room_are_dropped_and_counted(stuck: tuple[LogQueueHandler, list[str], threading.Event]):
    handler, written, reads = stuck
    for number in range(100):
        handler.handle(record("record %d", number))
    assert 96 <= handler.dropped <= 97  # three wait, and one may be with the writer already
    reads.set()
    handler.flush()
    dropped = handler.dropped
    assert written[:3] == ["record 0", "record 1", "record 2"]
    assert written[-1].startswith(f"{dropped} log records were dropped")
    handler.handle(record("after"))
    handler.flush()
    assert written[-1] == "after"
    assert handler.dropped == dropped


def test_an_unread_pipe_holds_up_neither_records_nor_the_end():
    reader, writer = os.pipe()
    handler = LogQueueHandler(StreamWriter(writer, JsonFormatter()), capacity=10)
    began = time.monotonic()
    for _ in range(400):
        handler.handle(record("x" * 1000))
    handler.close()
    assert time.monotonic() - began < 60  # it would never end
    assert handler.dropped > 100
    heard = b""
    while b"\n" not in heard:
        heard += os.read(reader, 65536)
    assert json.loads(heard.partition(b"\n")[0])["message"] == "x" * 1000
    os.close(reader)  # ends the writer's wait with a broken pipe
    while any(thread.name == "log" for thread in threading.enumerate()):
        try:
            handler._queue.put_nowait(None)
        except Exception:
            time.sleep(0.01)
    os.close(writer)


def test_a_full_journal_socket_holds_up_nothing(tmp_path: Path):
    address = str(tmp_path / "socket")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(address)
        writer = JournalWriter(address)
        handler = LogQueueHandler(writer, capacity=10, close_writer=writer.close)
        for number in range(5000):
            handler.handle(record("record %d", number))
        assert handler.dropped > 0
        journal.settimeout(60)
        heard = ""
        while f"({handler.dropped} in all)" not in heard:  # the last report: nothing is queued any more
            heard = journal.recv(65536).decode()
        handler.close()
        assert writer._socket.fileno() == -1  # the thread gave its socket back


def test_a_writer_that_fails_costs_its_record_only():
    written: list[str] = []

    def write(one: logging.LogRecord) -> None:
        if one.getMessage() == "bad":
            raise OSError(28, "No space left on device")
        written.append(one.getMessage())

    handler = LogQueueHandler(write)
    for text in ("bad", "good"):
        handler.handle(record(text))
    handler.flush()
    handler.close()
    assert written[0] == "good"
    assert handler.dropped == 1


def test_texts_are_made_when_logged_bounded_and_encodable():
    written: list[str] = []
    handler = LogQueueHandler(lambda one: written.append(one.getMessage()))
    values = [1]
    handler.handle(record("values %s", values))
    values.append(2)
    handler.handle(record("name %s", "\ud800"))
    handler.handle(record("y" * (2 * LONGEST_TEXT)))
    handler.handle(record("%d of %s", "no number"))
    handler.flush()
    handler.close()
    assert written[0] == "values [1]"
    assert written[1] == "name \\ud800"
    assert len(written[2]) < LONGEST_TEXT + 50
    assert handler.dropped == 1  # the last one cannot be formatted


def test_a_journal_that_was_started_again_is_connected_to_anew(tmp_path: Path):
    address = str(tmp_path / "socket")
    first = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    first.bind(address)
    writer = JournalWriter(address)
    first.close()
    os.unlink(address)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as second:
        second.bind(address)
        writer(record("again"))
        assert b"MESSAGE=again" in second.recv(65536)
    writer.close()
