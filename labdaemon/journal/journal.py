"""The one durable record and event outbox: an SQLite database in WAL mode, each commit synced to the disk.

One writer, guarded by a lock file, so that two daemons never share a data folder. Reads go over a connection of their
own: the event loop that publishes never waits for a writer's fsync.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from labdaemon.clock import Clock, rfc3339
from labdaemon.durable import supports_sync, sync_folder
from labdaemon.journal.event import EventText, StoredEvent, event_text, limit_bytes
from labdaemon.journal.schema import (
    APPLICATION_ID,
    CARD_TABLES,
    DECISION_TABLE,
    GAUGE_TABLE,
    LATER_INDEX,
    LIGHT_TABLE,
    QUEUE_TABLE,
    TABLES,
    VERSION,
)
from labdaemon.journal.storage import DataLock, JournalError, as_data_error
from labdaemon.plain_json import dump_json, plain_text

FILE_NAME = "journal.db"

BUSY_S = 4.0
"""How long a write waits for another process' lock before it is refused; the writer's own thread waits."""

READ_BUSY_S = 0.1
"""The same for a read: some are made on the event loop."""

CLOSE_S = 2.0
"""How long closing waits for a write that the disk has not taken; the process ends without it then."""


class Transaction:
    """What may be written together: rows and the events that report them.

    Made by `Journal.transaction` only; unusable after it.
    """

    def __init__(self, connection: sqlite3.Connection, at: str, last_seq: int) -> None:
        self._connection = connection
        self.at = at
        self.last_seq: int = last_seq

    def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
        """Run one statement."""
        return self._connection.execute(sql, _storable(values))

    def emit(self, kind: str, campaign: str | None, data: dict[str, Any]) -> int:
        """Append an event and return its `seq`, one more than the last one's.

        Raises
        ------
        ValueError, TypeError
            `data` is not JSON, NaN included.
        """
        text = dump_json(data)
        self.last_seq += 1
        self.execute("INSERT INTO events VALUES (?, ?, ?, ?, ?)", self.last_seq, self.at, kind, campaign, text)
        return self.last_seq


class Journal:
    """An open journal; also the outbox that the event stream is fed from.

    Parameters
    ----------
    folder
        The data folder; made if absent. The journal lies in it as ``journal.db``.
    clock
        Stamps events.
    replace_damaged
        Set a damaged journal aside under another name and begin a new one; otherwise it is refused.
    synchronous
        ``FULL`` syncs each commit. ``OFF`` is for simulated time, where nothing is worth keeping.
    lock
        Of the folder, where it was taken earlier; otherwise it is taken here. Released by `close`.

    Raises
    ------
    JournalError
        Another daemon holds it, it is of a newer version, or damaged.
    StorageUnavailable
        The disk is full, or another process has locked the journal, or it cannot be written now.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        *,
        replace_damaged: bool = False,
        synchronous: Literal["FULL", "OFF"] = "FULL",
        lock: DataLock | None = None,
    ) -> None:
        self.folder = folder
        self.path: Path = folder / FILE_NAME
        self._clock = clock
        self._synchronous = synchronous
        self._listeners: list[Callable[[str], None]] = []
        self._last_seq = 0
        self._write_lock, self._read_lock = threading.RLock(), threading.Lock()
        self._lock = lock or DataLock(folder)
        try:
            self._open(replace_damaged)
            self._device = folder.stat().st_dev
        except BaseException:
            self._lock.release()
            raise

    @property
    def last_seq(self) -> int:
        """`seq` of the latest committed event, 0 before the first."""
        return self._last_seq

    def events_after(self, seq: int, limit: int) -> list[StoredEvent]:
        """Committed events with a `seq` greater than this one, in order, at most `limit`."""
        rows = self.read(
            "SELECT seq, at, kind, campaign, data FROM events WHERE seq > ? ORDER BY seq LIMIT ?", seq, limit
        )
        return [StoredEvent(row[0], row[1], row[2], row[3], json.loads(row[4]), self.uuid) for row in rows]

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """Events after this `seq` as they travel, at most `limit` and, from the second on, `most_bytes`; quick."""
        with self._read_lock:
            return self._texts(self._reader, seq, limit, most_bytes)

    def history(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """As `recent`, over a connection of its own: for reading much, on any thread, while the loop reads little."""
        with closing(self._own_reader()) as reader:
            return self._texts(reader, seq, limit, most_bytes)

    def latest(self) -> list[EventText]:
        """The last event of each kind as it travels, ascending; for any thread, as `history`."""
        # The index of campaigns and kinds answers the inner query without reading any payload.
        sql = (
            "SELECT seq, at, kind, campaign, data FROM events "
            "WHERE seq IN (SELECT max(seq) FROM events GROUP BY kind) ORDER BY seq"
        )
        with closing(self._own_reader()) as reader:
            try:
                return [event_text(row, self.uuid) for row in reader.execute(sql)]
            except sqlite3.Error as exc:
                raise as_data_error(exc, self.path, is_read=True) from exc

    def _own_reader(self) -> sqlite3.Connection:
        try:
            return sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)
        except sqlite3.Error as exc:
            raise as_data_error(exc, self.path) from exc

    def _texts(self, reader: sqlite3.Connection, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        """Row by row, so that no more is read than is sent."""
        sql = "SELECT seq, at, kind, campaign, data FROM events WHERE seq > ? ORDER BY seq LIMIT ?"
        try:
            with closing(reader.execute(sql, (seq, limit))) as rows:
                return limit_bytes((event_text(row, self.uuid) for row in rows), most_bytes)
        except sqlite3.Error as exc:
            raise as_data_error(exc, self.path, is_read=True) from exc

    def read(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        """Rows of what is committed."""
        with self._read_lock:
            try:
                return self._reader.execute(sql, _storable(values)).fetchall()
            except sqlite3.Error as exc:
                raise as_data_error(exc, self.path, is_read=True) from exc

    @contextmanager
    def transaction(self, name: str) -> Iterator[Transaction]:
        """Write rows and events together or not at all; synced to the disk when the block is left.

        `name` names the transition for listeners, which are called after the commit.
        """
        with self._write_lock:
            transaction = Transaction(self._writer, rfc3339(self._clock.now()), self._last_seq)
            try:
                self._writer.execute("BEGIN IMMEDIATE")
                yield transaction
                self._notify(f"before {name}")
                self._writer.execute("COMMIT")
            except sqlite3.Error as exc:
                self._roll_back()
                raise as_data_error(exc, self.path) from exc
            except BaseException:
                self._roll_back()
                raise
            self._last_seq = transaction.last_seq
        self._notify(name)

    def listen(self, listener: Callable[[str], None]) -> None:
        """Call `listener(name)` after each commit, on the writing thread, and with ``before NAME`` ahead of it.

        It must be quick and must not raise.
        """
        self._listeners.append(listener)

    def check_place(self) -> None:
        """Look whether the folder's path still leads to this journal's disk.

        Raises
        ------
        JournalError
            Another disk lies there: one was mounted over it, or unmounted.
        OSError
            None lies there now.
        """
        # The device alone: some network shares give a folder a new inode number now and then.
        if self.folder.stat().st_dev != self._device:
            raise JournalError(
                "another disk lies there since the start (mounted or unmounted?); start again", file=self.folder
            )

    def close(self) -> None:
        """Close it and let another daemon have it."""
        # A disk that hangs holds a write, and with it the lock, for as long as it likes.
        if self._write_lock.acquire(timeout=CLOSE_S):
            try:
                with self._read_lock:
                    self._writer.close()
                    self._reader.close()
            finally:
                self._write_lock.release()
        self._lock.release()

    def _notify(self, name: str) -> None:
        for listener in self._listeners:
            listener(name)

    def _roll_back(self) -> None:
        with suppress(sqlite3.Error):  # a disk that is gone rolls back by itself when it is opened again
            if self._writer.in_transaction:
                self._writer.execute("ROLLBACK")

    def _open(self, replace_damaged: bool) -> None:
        try:
            self._connect()
        except JournalError as exc:
            if not (replace_damaged and "damaged" in str(exc)):
                raise
            set_aside(self.path, rfc3339(self._clock.now()))
            self._connect()

    def _connect(self) -> None:
        try:
            fresh = not self.path.exists() or self.path.stat().st_size == 0
            self._writer = sqlite3.connect(self.path, BUSY_S, isolation_level=None, check_same_thread=False)
            try:
                if not fresh:
                    self._check()
                self._writer.execute("PRAGMA journal_mode = WAL")
                # Where files cannot be synced SQLite would fail each commit, not only be less durable.
                synchronous = self._synchronous if supports_sync(self.folder) else "OFF"
                self._writer.execute(f"PRAGMA synchronous = {synchronous}")
                if fresh or not self._writer.execute("PRAGMA user_version").fetchone()[0]:
                    self._create()
                with suppress(
                    sqlite3.Error
                ):  # a full or locked disk: without it the daemon is slower, and nothing else
                    self._writer.execute(LATER_INDEX)
                self._writer.execute(QUEUE_TABLE)
                self._add_card_tables()
                self._writer.execute(LIGHT_TABLE)
                self._writer.execute(GAUGE_TABLE)
                self._writer.execute(DECISION_TABLE)
                self._reader = sqlite3.connect(self.path, READ_BUSY_S, isolation_level=None, check_same_thread=False)
                self._reader.execute("PRAGMA query_only = ON")
                self.uuid: str = self._reader.execute("SELECT value FROM meta WHERE key = 'uuid'").fetchone()[0]
                self._last_seq = self._reader.execute("SELECT coalesce(max(seq), 0) FROM events").fetchone()[0]
            except BaseException:
                self._writer.close()
                raise
            if fresh:
                sync_folder(self.folder)
        except (sqlite3.Error, OSError) as exc:
            raise as_data_error(exc, self.path) from exc

    def _check(self) -> None:
        version = self._writer.execute("PRAGMA user_version").fetchone()[0]
        tables = self._writer.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        application = self._writer.execute("PRAGMA application_id").fetchone()[0]
        if tables and application != APPLICATION_ID:
            raise JournalError("is a database of another program; give another --data", file=self.path)
        if version > VERSION:
            raise JournalError(
                f"is of version {version}, this labdaemon knows up to {VERSION}; install the newer one", file=self.path
            )
        verdict = self._writer.execute("PRAGMA quick_check(1)").fetchone()[0]
        if verdict != "ok":
            raise sqlite3.DatabaseError(f"malformed: {verdict}")

    def _add_card_tables(self) -> None:
        """Tables that a journal of an earlier version lacks; they start from what it knew."""
        if self._writer.execute("SELECT 1 FROM sqlite_master WHERE name = 'card_files'").fetchone():
            return
        with self._writer:
            self._writer.execute("BEGIN IMMEDIATE")
            for statement in CARD_TABLES.split(";\n"):
                self._writer.execute(statement)

    def _create(self) -> None:
        with self._writer:
            self._writer.execute("BEGIN IMMEDIATE")
            for statement in TABLES.split(";\n"):
                self._writer.execute(statement)
            self._writer.execute("INSERT INTO meta VALUES ('uuid', ?)", (str(uuid.uuid4()),))
            self._writer.execute("INSERT INTO meta VALUES ('created_at', ?)", (rfc3339(self._clock.now()),))
            self._writer.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            self._writer.execute(f"PRAGMA user_version = {VERSION}")


def _storable(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Values as the database takes them: a file name that is no UTF-8 must not end what writes it down."""
    return tuple(plain_text(value) if isinstance(value, str) else value for value in values)


def set_aside(path: Path, at: str) -> Path:
    """Rename a damaged journal with what belongs to it, keeping every byte, and return its new place."""
    stamp = at.replace(":", "").replace("-", "")
    kept = path.with_name(f"{path.stem}.damaged-{stamp}{path.suffix}")
    for suffix in ("-wal", "-shm", ""):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.rename(kept.with_name(kept.name + suffix))
    return kept
