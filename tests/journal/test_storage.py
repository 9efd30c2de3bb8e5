"""What a failed read or write of the journal means, and who may write to a data folder."""

from __future__ import annotations

import errno
import fcntl
import os
import sqlite3
from pathlib import Path

import pytest

from labdaemon import durable
from labdaemon.errors import StorageError, StorageFull, StorageUnavailable
from labdaemon.journal.storage import LOCK_NAME, DataLock, JournalError, JournalLocked, as_data_error, probe_disk


def sqlite_error(code: int, text: str = "it went wrong") -> sqlite3.Error:
    error = sqlite3.OperationalError(text)
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize(("code", "kind", "words"), [
    (sqlite3.SQLITE_FULL, StorageFull, "free some space"),
    (sqlite3.SQLITE_BUSY, JournalLocked, "waits until it lets go"),
    (sqlite3.SQLITE_LOCKED, JournalLocked, "waits until it lets go"),
    (sqlite3.SQLITE_READONLY, StorageUnavailable, "remount, chown or put it back"),
    (sqlite3.SQLITE_CANTOPEN, StorageUnavailable, "remount, chown or put it back"),
    (sqlite3.SQLITE_READONLY | 4 << 8, StorageUnavailable, "remount"),
])  # fmt: skip
def test_codes_of_sqlite_are_said_in_words(tmp_path: Path, code: int, kind: type[StorageError], words: str) -> None:
    error = as_data_error(sqlite_error(code), tmp_path / "journal.db")
    assert type(error) is kind
    assert error.retryable
    assert words in str(error)
    assert "journal.db" in str(error)


@pytest.mark.parametrize("is_read", [True, False])
def test_an_input_or_output_error_may_pass(tmp_path: Path, is_read: bool) -> None:
    error = as_data_error(sqlite_error(sqlite3.SQLITE_IOERR), tmp_path / "journal.db", is_read=is_read)
    assert type(error) is StorageUnavailable
    assert "check that it is connected" in str(error)


@pytest.mark.parametrize("text", ["database disk image is malformed", "file is not a database", "Corrupt page"])
def test_a_damaged_journal_needs_a_person(tmp_path: Path, text: str) -> None:
    error = as_data_error(sqlite_error(0, text), tmp_path / "journal.db")
    assert type(error) is JournalError
    assert not error.retryable
    assert "--new-journal" in str(error)


def test_an_error_of_the_system_keeps_its_meaning(tmp_path: Path) -> None:
    full = as_data_error(OSError(errno.ENOSPC, "No space left on device"), tmp_path)
    assert isinstance(full, StorageFull)


def test_a_probe_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "journal.db").write_bytes(b"x" * 5000)
    (tmp_path / "journal.db-wal").write_bytes(b"x" * 100)
    probe_disk(tmp_path / "journal.db")
    assert {path.name for path in tmp_path.iterdir()} == {"journal.db", "journal.db-wal"}


def test_a_folder_is_held_by_one_and_then_by_another(tmp_path: Path) -> None:
    first = DataLock(tmp_path / "data")
    with pytest.raises(JournalError, match=f"process {os.getpid()}"):
        DataLock(tmp_path / "data")
    first.release()
    second = DataLock(tmp_path / "data")
    assert (tmp_path / "data" / LOCK_NAME).read_text() == f"{os.getpid()}\n"
    second.release()


def test_locks_of_the_second_kind_are_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some shares know no flock."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(durable, "_warned", set())  # each warning comes once a process, and other tests cause it too
    monkeypatch.setattr(fcntl, "flock", refuse)
    DataLock(tmp_path).release()


def test_a_file_system_without_locks_is_used_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(durable, "_warned", set())  # each warning comes once a process, and other tests cause it too
    monkeypatch.setattr(fcntl, "flock", refuse)
    monkeypatch.setattr(fcntl, "lockf", refuse)
    DataLock(tmp_path).release()
    assert "knows no locks" in caplog.text
