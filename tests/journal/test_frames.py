from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path

import pytest

from labdaemon.errors import DataError, StorageFull
from labdaemon.journal.frames import move_new, part_of, remove_parts, seal_new


def test_a_sealed_frame_is_whole_hashed_and_under_its_final_name(tmp_path: Path):
    path = tmp_path / "captures" / "one" / "left.dng"
    content = os.urandom(3_000_000)
    part_of(path).write_bytes(content)
    assert seal_new(path, len(content)) == (path, len(content), hashlib.sha256(content).hexdigest())
    assert path.read_bytes() == content
    assert not part_of(path).exists()


def test_a_frame_of_another_size_is_refused_and_its_part_removed(tmp_path: Path):
    path = tmp_path / "left.dng"
    part_of(path).write_bytes(b"short")
    with pytest.raises(DataError, match="has 5 bytes, the camera said 6"):
        seal_new(path, 6)
    assert list(tmp_path.iterdir()) == []


def test_a_sync_comes_before_the_rename_and_the_folders_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    done: list[str] = []
    fsync, link = os.fsync, os.link
    monkeypatch.setattr(os, "fsync", lambda fd: (done.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd))[1])
    monkeypatch.setattr(os, "link", lambda path, to: (done.append("rename"), link(path, to))[1])
    path = tmp_path / "left.dng"
    part_of(path).write_bytes(b"frame")
    seal_new(path)
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
        seal_new(tmp_path / "left.dng")
    assert not (tmp_path / "left.dng").exists()


@pytest.mark.parametrize("has_links", [True, False])
def test_no_frame_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool):
    def refuse(path: Path, to: Path) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")  # exFAT knows no links

    if not has_links:
        monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "left-DSC_0001.dng"
    places = []
    for content in (b"one", b"two", b"three"):
        part_of(path).write_bytes(content)
        places.append(seal_new(path, len(content))[0])
    assert [place.name for place in places] == ["left-DSC_0001.dng", "left-DSC_0001~2.dng", "left-DSC_0001~3.dng"]
    assert path.read_bytes() == b"one"
    (tmp_path / "moved").write_bytes(b"four")
    assert move_new(tmp_path / "moved", path).name == "left-DSC_0001~4.dng"
    assert sorted(file.read_bytes() for file in tmp_path.glob("*.dng")) == [b"four", b"one", b"three", b"two"]


def test_a_frame_that_a_crash_left_sealed_is_that_frame(tmp_path: Path):
    path = tmp_path / "left.dng"
    for _ in range(2):
        part_of(path).write_bytes(b"frame")
        assert seal_new(path)[0] == path
    assert [file.name for file in tmp_path.iterdir()] == ["left.dng"]
