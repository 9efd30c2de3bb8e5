from __future__ import annotations

import errno
import logging
import os
import resource
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from labdaemon import durable
from labdaemon.durable import (
    append_durably,
    check_place,
    make_folder,
    move_durably,
    probe_folder,
    storage_error,
    supports_sync,
    sync_folder,
    whole_file,
    write_durably,
)
from labdaemon.errors import StorageError, StorageFull, StorageUnavailable


@pytest.fixture(autouse=True)
def nothing_warned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durable, "_warned", set())


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Paths in the order in which they were synced."""
    done: list[str] = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (done.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd))[1])
    return done


def refuse(number: int, *, folders: bool) -> Callable[[int], None]:
    """An fsync that fails on folders, or on files."""
    fsync = os.fsync

    def fake(fd: int) -> None:
        if stat.S_ISDIR(os.fstat(fd).st_mode) == folders:
            raise OSError(number, os.strerror(number))
        fsync(fd)

    return fake


def test_a_small_file_is_replaced_whole(tmp_path: Path):
    path = tmp_path / "deep" / "capture.toml"
    write_durably(path, "one")
    write_durably(path, "two")
    assert path.read_text() == "two"
    assert [file.name for file in path.parent.iterdir()] == ["capture.toml"]


def test_results_that_could_not_be_written_are_refused_before_the_work(tmp_path: Path):
    check_place(tmp_path / "new" / "results", ["envelope.csv"])
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    (tmp_path / "envelope.csv").mkdir()
    for place, file in (("file", ""), ("file/results", ""), ("link", ""), ("link/results", ""), (".", "envelope.csv")):
        with pytest.raises(StorageError, match="cannot be written"):
            check_place(tmp_path / place, [file] if file else [])


def test_a_moved_frame_is_gone_from_its_old_place(tmp_path: Path):
    old, new = tmp_path / "left.dng", tmp_path / "set_aside" / "x" / "left.dng"
    old.write_bytes(b"frame")
    move_durably(old, new)
    assert new.read_bytes() == b"frame"
    assert not old.exists()


def test_new_folders_are_synced_into_their_parents(tmp_path: Path, synced: list[str]):
    write_durably(tmp_path / "data" / "campaigns" / "0001" / "rig.toml", "x")
    assert synced[:3] == [str(tmp_path), str(tmp_path / "data"), str(tmp_path / "data" / "campaigns")]
    assert synced[-1] == str(tmp_path / "data" / "campaigns" / "0001")


def test_appended_rows_are_synced_and_a_new_file_with_its_folder(tmp_path: Path, synced: list[str]):
    path = tmp_path / "envelope.csv"
    append_durably(path, "one\n")
    append_durably(path, "two\n")
    assert path.read_text() == "one\ntwo\n"
    assert synced == [str(path), str(tmp_path), str(path)]


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF])
def test_a_folder_that_cannot_be_synced_is_used_with_one_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, number: int
):
    monkeypatch.setattr(os, "fsync", refuse(number, folders=True))
    with caplog.at_level(logging.WARNING, "labdaemon"):
        for name in ("a", "b", "c"):
            write_durably(tmp_path / name / "file", name)
            move_durably(tmp_path / name / "file", tmp_path / "moved" / name)
    assert sorted(path.name for path in (tmp_path / "moved").iterdir()) == ["a", "b", "c"]
    assert ["cannot sync folders" in record.message for record in caplog.records] == [True]


def test_files_that_cannot_be_synced_are_used_with_one_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setattr(os, "fsync", refuse(errno.EINVAL, folders=False))
    with caplog.at_level(logging.WARNING, "labdaemon"):
        write_durably(tmp_path / "a", "a")
        append_durably(tmp_path / "a", "b")
        assert not supports_sync(tmp_path)
    assert (tmp_path / "a").read_text() == "ab"
    assert len(caplog.records) == 1


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_a_sync_of_a_folder_that_failed_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int):
    monkeypatch.setattr(os, "fsync", refuse(number, folders=True))
    with pytest.raises(StorageUnavailable):
        write_durably(tmp_path / "file", "x")


def test_a_folder_that_may_not_be_read_is_not_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def forbid(path: object, flags: int) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "open", forbid)
    sync_folder(tmp_path)


@pytest.mark.parametrize(
    ("number", "kind", "word"),
    [
        (errno.ENOSPC, StorageFull, "full"),
        (errno.EDQUOT, StorageFull, "full"),
        (errno.EFBIG, StorageFull, "full"),
        (errno.EIO, StorageUnavailable, "does not answer"),
        (errno.ESTALE, StorageUnavailable, "does not answer"),
        (errno.EROFS, StorageError, "read-only disk"),
        (errno.EACCES, StorageError, "missing permission"),
        (errno.ENAMETOOLONG, StorageError, "name too long"),
    ],
)
def test_an_error_says_whether_waiting_helps(number: int, kind: type[StorageError], word: str):
    error = storage_error(OSError(number, os.strerror(number)), Path("/data/x"))
    assert type(error) is kind
    assert error.retryable == issubclass(kind, StorageUnavailable)
    assert word in str(error).lower()


def test_what_was_there_stays_when_a_write_fails(tmp_path: Path):
    path = tmp_path / "rows.csv"
    write_durably(path, "before")
    with pytest.raises(TypeError), whole_file(path) as file:
        file.writelines([b"half", None])  # type: ignore[list-item]
    assert path.read_text() == "before"
    assert [file.name for file in tmp_path.iterdir()] == ["rows.csv"]


def test_a_limit_on_length_is_a_full_disk_and_half_a_row_is_taken_back(tmp_path: Path):
    path = tmp_path / "rows.csv"
    append_durably(path, "row\n")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(StorageFull):
            append_durably(path, "x" * 200_000)
        with pytest.raises(StorageFull):
            probe_folder(tmp_path, 60_000)
        probe_folder(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text() == "row\n"
    assert [file.name for file in tmp_path.iterdir()] == ["rows.csv"]


def test_a_place_that_is_no_folder_yet_is_no_traceback(tmp_path: Path):
    (tmp_path / "disk").write_text("nothing is mounted here yet")
    (tmp_path / "link").symlink_to(tmp_path / "not there yet")
    for place in ("disk", "link"):
        with pytest.raises(StorageError, match="cannot be written"):
            make_folder(tmp_path / place / "data")
