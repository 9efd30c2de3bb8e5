from __future__ import annotations

import errno
import fcntl
import os
import resource
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock, SystemClock
from labdaemon.errors import StorageFull, StorageUnavailable
from labdaemon.journal.journal import Journal
from labdaemon.journal.schema import VERSION
from labdaemon.journal.storage import DataLock, JournalError, JournalLocked, as_data_error


@pytest.fixture
def journal(tmp_path: Path):
    journal = Journal(tmp_path, SimulatedClock())
    yield journal
    journal.close()


def emit(journal: Journal, count: int = 1) -> None:
    for number in range(count):
        with journal.transaction("test") as write:
            write.emit("fault", None, {"number": number})


def test_seq_rises_by_one_over_restarts_and_the_uuid_stays(tmp_path: Path):
    first = Journal(tmp_path, SimulatedClock())
    emit(first, 3)
    uuid = first.uuid
    first.close()
    second = Journal(tmp_path, SimulatedClock())
    emit(second, 2)
    assert [event.seq for event in second.events_after(0, 10)] == [1, 2, 3, 4, 5]
    assert {event.journal for event in second.events_after(0, 10)} == {uuid}
    assert [event.seq for event in second.events_after(3, 1)] == [4]
    second.close()


def test_a_failed_transaction_leaves_no_event_and_no_gap(journal: Journal):
    emit(journal)

    def write_half() -> None:
        with journal.transaction("test") as write:
            write.emit("fault", None, {"first": "is written"})
            write.emit("fault", None, {"second": object()})

    with pytest.raises(TypeError):
        write_half()
    emit(journal)
    assert [event.seq for event in journal.events_after(0, 10)] == [1, 2]
    assert journal.last_seq == 2


def test_not_a_number_is_refused_and_nothing_is_written(journal: Journal):
    with pytest.raises(ValueError, match="not JSON compliant"), journal.transaction("test") as write:
        write.emit("envelope", None, {"ax_mm": float("nan")})
    assert journal.events_after(0, 10) == []


def test_listeners_hear_before_and_after_the_commit(journal: Journal):
    heard: list[tuple[str, int]] = []
    journal.listen(lambda name: heard.append((name, len(journal.events_after(0, 10)))))
    emit(journal)
    assert heard == [("before test", 0), ("test", 1)]


def test_a_commit_is_synced_and_in_wal_mode(journal: Journal):
    assert journal._writer.execute("PRAGMA synchronous").fetchone()[0] == 2
    assert journal.read("PRAGMA journal_mode") == [("wal",)]


def test_a_second_daemon_is_refused_and_told_who_holds_the_folder(journal: Journal, tmp_path: Path):
    code = "import sys, pathlib, labdaemon.journal.storage as s; s.DataLock(pathlib.Path(sys.argv[1]))"
    other = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert other.returncode != 0
    assert "another labdaemon (process" in other.stderr


def test_a_lock_goes_with_its_holder(tmp_path: Path):
    DataLock(tmp_path).release()
    DataLock(tmp_path).release()


def test_a_journal_of_a_newer_version_is_refused_and_left_as_it_is(tmp_path: Path):
    Journal(tmp_path, SimulatedClock()).close()
    path = tmp_path / "journal.db"
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    connection.close()
    before = path.read_bytes()
    with pytest.raises(JournalError, match=rf"version {VERSION + 1}.*newer"):
        Journal(tmp_path, SimulatedClock(), replace_damaged=True)
    assert path.read_bytes() == before


def test_another_programs_database_is_refused(tmp_path: Path):
    with sqlite3.connect(tmp_path / "journal.db") as connection:
        connection.execute("CREATE TABLE bookmarks (url)")
    connection.close()
    with pytest.raises(JournalError, match="another program"):
        Journal(tmp_path, SimulatedClock())


@pytest.mark.parametrize("damage", ["header", "middle"])
def test_a_damaged_journal_is_kept_aside_and_never_overwritten(tmp_path: Path, damage: str):
    journal = Journal(tmp_path, SimulatedClock())
    emit(journal, 200)
    uuid = journal.uuid
    journal.close()
    path = tmp_path / "journal.db"
    content = bytearray(path.read_bytes())
    start = 0 if damage == "header" else 8192
    content[start : start + 4096] = b"\xa5" * 4096
    path.write_bytes(content)
    with pytest.raises(JournalError, match=r"damaged.*--new-journal"):
        Journal(tmp_path, SimulatedClock())
    assert path.read_bytes() == content
    fresh = Journal(tmp_path, SimulatedClock(), replace_damaged=True)
    assert fresh.last_seq == 0
    assert fresh.uuid != uuid
    [kept] = tmp_path.glob("journal.damaged-*.db")
    assert kept.read_bytes() == content
    fresh.close()


def test_a_full_disk_says_so_and_what_was_committed_stays(journal: Journal):
    emit(journal, 2)
    pages = journal._writer.execute("PRAGMA page_count").fetchone()[0]
    journal._writer.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StorageFull, match="disk is full"), journal.transaction("test") as write:
        write.emit("fault", None, {"text": "x" * 100_000})
    assert journal.last_seq == 2
    journal._writer.execute(f"PRAGMA max_page_count = {pages + 1000}")
    emit(journal)
    assert [event.seq for event in journal.events_after(0, 10)] == [1, 2, 3]


def test_a_read_only_disk_is_waited_for(tmp_path: Path, journal: Journal):
    other = sqlite3.connect("file:" + str(tmp_path / "journal.db") + "?mode=ro", uri=True)
    with pytest.raises(sqlite3.OperationalError) as raised:
        other.execute("INSERT INTO meta VALUES ('a', 'b')")
    error = as_data_error(raised.value, Path("/data"))
    other.close()
    assert "read-only disk" in str(error)
    assert error.retryable


def test_a_lock_of_another_process_is_waited_for(tmp_path: Path, journal: Journal, monkeypatch: pytest.MonkeyPatch):
    journal._writer.execute("PRAGMA busy_timeout = 50")
    other = sqlite3.connect(tmp_path / "journal.db", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(JournalLocked, match="another process has locked") as raised:
        emit(journal)
    assert raised.value.retryable
    assert journal.events_after(0, 10) == []
    other.execute("ROLLBACK")
    other.close()
    emit(journal)
    assert [event.seq for event in journal.events_after(0, 10)] == [1]


def test_a_quota_that_is_used_up_is_a_full_disk(journal: Journal):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    emit(journal)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
    try:
        with pytest.raises(StorageFull), journal.transaction("test") as write:
            write.emit("fault", None, {"text": "x" * 100_000})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    emit(journal)
    assert [event.seq for event in journal.events_after(0, 10)] == [1, 2]


def test_a_folder_without_sync_or_locks_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOTSUP, "Operation not supported")

    for module, name in ((os, "fsync"), (fcntl, "flock"), (fcntl, "lockf")):
        monkeypatch.setattr(module, name, refuse)
    journal = Journal(tmp_path, SimulatedClock())
    emit(journal)
    assert journal.last_seq == 1
    journal.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a disk needs root")
def test_a_disk_mounted_over_the_folder_is_noticed(tmp_path: Path):
    data = tmp_path / "data"
    journal = Journal(data, SimulatedClock())
    journal.check_place()
    if subprocess.run(["mount", "-t", "tmpfs", "tmpfs", data]).returncode:
        journal.close()
        pytest.skip("a disk cannot be mounted here")
    try:
        with pytest.raises(JournalError, match="another disk"):
            journal.check_place()
    finally:
        subprocess.run(["umount", data], check=True)
    journal.check_place()
    journal.close()


def test_closing_does_not_wait_for_a_write_that_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("labdaemon.journal.journal.CLOSE_S", 0.05)
    journal = Journal(tmp_path, SimulatedClock())
    hangs, end = threading.Event(), threading.Event()

    def write() -> None:
        with journal.transaction("test"):
            hangs.set()
            end.wait()

    thread = threading.Thread(target=write)
    thread.start()
    hangs.wait()
    journal.close()
    end.set()
    thread.join()
    DataLock(tmp_path).release()
    journal._writer.close()
    journal._reader.close()


def test_events_are_stamped_by_the_clock_and_may_jump_while_seq_does_not(tmp_path: Path):
    clock = SimulatedClock()
    journal = Journal(tmp_path, clock)
    emit(journal)
    clock.jump(-3600)
    emit(journal)
    first, second = journal.events_after(0, 10)
    assert second.at < first.at
    assert second.seq == first.seq + 1
    journal.close()


def test_the_journal_outlives_its_process_being_killed(tmp_path: Path):
    code = f"""
import os, signal
from pathlib import Path
from labdaemon.clock import SystemClock
from labdaemon.journal.journal import Journal
journal = Journal(Path({str(tmp_path)!r}), SystemClock())
for number in range(5):
    with journal.transaction("test") as write:
        write.emit("fault", None, {{"number": number}})
with journal.transaction("test") as write:
    write.emit("fault", None, {{"number": 5}})
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    journal = Journal(tmp_path, SystemClock())
    assert [event.data["number"] for event in journal.events_after(0, 10)] == [0, 1, 2, 3, 4]
    journal.close()


def test_a_journal_that_another_thread_closed_is_no_damage(tmp_path: Path):
    """The daemon ends while a client's question is on its way: nothing is wrong with the disk."""
    journal = Journal(tmp_path, SystemClock())
    journal.close()
    for call in (lambda: journal.read("SELECT 1"), lambda: journal.recent(0, 1, 100)):
        with pytest.raises(StorageUnavailable, match="this daemon is ending"):
            call()
    with pytest.raises(StorageUnavailable, match="this daemon is ending"), journal.transaction("late"):
        pytest.fail("it was begun")
