from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from labdaemon.errors import DataError, StorageFull
from labdaemon.journal.frames import part_of, remove_parts, seal


def test_a_sealed_frame_is_whole_hashed_and_under_its_final_name(tmp_path: Path):
    path = tmp_path / "captures" / "one" / "left.dng"
    content = os.urandom(3_000_000)
    part_of(path).write_bytes(content)
    assert seal(path, len(content)) == (len(content), hashlib.sha256(content).hexdigest())
    assert path.read_bytes() == content
    assert not part_of(path).exists()


def test_a_frame_of_another_size_is_refused_and_its_part_removed(tmp_path: Path):
    path = tmp_path / "left.dng"
    part_of(path).write_bytes(b"short")
    with pytest.raises(DataError, match="has 5 bytes, the camera said 6"):
        seal(path, 6)
    assert list(tmp_path.iterdir()) == []


def test_a_sync_comes_before_the_rename_and_the_folders_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    done: list[str] = []
    fsync, rename = os.fsync, Path.rename
    monkeypatch.setattr(os, "fsync", lambda fd: (done.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd))[1])
    monkeypatch.setattr(Path, "rename", lambda path, to: (done.append("rename"), rename(path, to))[1])
    path = tmp_path / "left.dng"
    part_of(path).write_bytes(b"frame")
    seal(path)
    assert done == [str(part_of(path)), "rename", str(tmp_path)]


def test_parts_are_found_wherever_they_are(tmp_path: Path):
    own = f".own.{os.getpid()}.part"
    for name in ("a/left.dng.part", "b.part", "c.dng", own, ".dead.99999999.part"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    assert {path.name for path in remove_parts(tmp_path)} == {"left.dng.part", "b.part", own, ".dead.99999999.part"}
    assert (tmp_path / "c.dng").exists()


def test_a_part_that_another_process_writes_is_left_alone(tmp_path: Path):
    part = tmp_path / f".envelope.csv.{os.getppid()}.part"
    part.write_bytes(b"x")
    assert remove_parts(tmp_path) == []
    assert part.exists()


def test_a_full_disk_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(fd: int) -> None:
        raise OSError(28, "No space left on device")

    part_of(tmp_path / "left.dng").write_bytes(b"frame")
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(StorageFull, match="disk is full"):
        seal(tmp_path / "left.dng")
    assert not (tmp_path / "left.dng").exists()
