from __future__ import annotations

import os
from pathlib import Path

import pytest

from labdaemon.campaign.measurement_queue import CaptureRows
from labdaemon.errors import StorageError
from labdaemon.processing import ENVELOPE_COLUMNS, read_csv
from labdaemon.service.result_files import ResultFiles, captures_in, stamp


def result(name: str, x_mm: float) -> CaptureRows:
    row = dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": name, "target": "T1", "x_mm": x_mm, "flags": ["at_rest"]}
    return CaptureRows([row], [])


def test_files_are_written_anew_and_added_to(tmp_path: Path):
    files = ResultFiles()
    files.write(tmp_path, (result(name, 1.5) for name in ("a", "b")))
    assert files.append(tmp_path, result("c", 2.5))
    rows = read_csv(tmp_path / "results" / "envelope.csv")
    assert [(row["capture"], row["x_mm"], row["flags"]) for row in rows] == [
        ("a", 1.5, ["at_rest"]), ("b", 1.5, ["at_rest"]), ("c", 2.5, ["at_rest"]),
    ]  # fmt: skip
    files.write(tmp_path, [])
    assert read_csv(tmp_path / "results" / "envelope.csv") == []
    assert {path.name for path in (tmp_path / "results").iterdir()} == {"envelope.csv", "measurements.csv"}


def test_all_rows_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    sizes: dict[str, int] = {}
    fsync = os.fsync

    def note(fd: int) -> None:
        fsync(fd)
        name = os.readlink(f"/proc/self/fd/{fd}").rpartition("/")[2].removeprefix(".").partition(".csv")[0]
        sizes[name] = os.fstat(fd).st_size

    monkeypatch.setattr(os, "fsync", note)
    files = ResultFiles()
    files.write(tmp_path, [result("a", 1.0)])
    files.append(tmp_path, result("b", 1.0))
    for path in (tmp_path / "results").iterdir():
        assert sizes[path.stem] == path.stat().st_size


@pytest.mark.parametrize("name", ["envelope.csv", "measurements.csv"])
@pytest.mark.parametrize("meddle", [Path.unlink, lambda path: path.write_text("another's"), lambda path: path.touch()])
def test_files_that_another_program_wrote_to_are_not_added_to(tmp_path: Path, name: str, meddle):
    files = ResultFiles()
    files.write(tmp_path, [result("a", 1.0)])
    meddle(tmp_path / "results" / name)
    assert not files.append(tmp_path, result("b", 1.0))
    assert not files.append(tmp_path, result("b", 1.0))
    files.write(tmp_path, [result("a", 1.0), result("b", 1.0)])
    assert files.append(tmp_path, result("c", 1.0))


def test_a_failed_write_is_made_good_by_writing_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    files = ResultFiles()
    files.write(tmp_path, [result("a", 1.0)])
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", lambda fd: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(StorageError):
            files.append(tmp_path, result("b", 1.0))
    assert captures_in(tmp_path) == {"a"}
    assert not files.append(tmp_path, result("b", 1.0))


@pytest.mark.parametrize("tail", [b"", b"\0" * 500, b"cut, half a r\xc3"])
def test_what_a_power_cut_left_is_read(tmp_path: Path, tail: bytes):
    files = ResultFiles()
    files.write(tmp_path, [result("a", 1.0), result("b", 1.0)])
    kept = stamp(tmp_path)
    path = tmp_path / "results" / "envelope.csv"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2]) + tail)
    assert stamp(tmp_path) != kept
    assert captures_in(tmp_path) & {"a", "b"} == {"a"}
    path.unlink()
    assert captures_in(tmp_path) == set()
