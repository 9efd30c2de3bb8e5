"""Files against recorded hashes, and rows against rows."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from pathlib import Path

import pytest

from labdaemon.analysis.verification import CRATE, check_files, compare_rows
from labdaemon.errors import DataError
from labdaemon.journal.journal import FILE_NAME


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "data" / "campaigns" / "0001-modes"
    for name in ("sharp/left.dng", "captures/c1/left.dng", "rig.toml"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(name.encode())
    return root


def crate(folder: Path, *names: str) -> None:
    files = [{"@id": name, "sha256": hashlib.sha256(name.encode()).hexdigest()} for name in names]
    (folder / CRATE).write_text(json.dumps({"@graph": [{"@id": "./"}, *files]}), encoding="utf-8")


def journal(folder: Path, campaign: str, *names: str) -> None:
    with sqlite3.connect(folder.parent.parent / FILE_NAME) as database:
        database.execute("CREATE TABLE frames (campaign TEXT, path TEXT, sha256 TEXT)")
        for name in names:
            row = (campaign, f"campaigns/{folder.name}/{name}", hashlib.sha256(name.encode()).hexdigest())
            database.execute("INSERT INTO frames VALUES (?, ?, ?)", row)
    database.close()


def test_without_records_nothing_is_claimed(folder: Path):
    checked = check_files(folder)
    assert (checked.sources, checked.checked, checked.differences, checked.unrecorded) == ((), 0, (), 2)


def test_the_crate_and_the_journal_are_both_compared_with(folder: Path):
    crate(folder, "rig.toml")
    journal(folder, folder.name, "sharp/left.dng", "captures/c1/left.dng")
    checked = check_files(folder)
    assert checked.sources == ("journal", CRATE)
    assert (checked.checked, checked.differences, checked.unrecorded) == (3, (), 0)


def test_frames_of_another_campaign_are_none_of_this_one(folder: Path):
    journal(folder, "0002-other", "sharp/left.dng")
    assert check_files(folder).checked == 0


def test_a_changed_and_a_missing_file_are_named(folder: Path):
    crate(folder, "rig.toml", "sharp/left.dng")
    (folder / "rig.toml").write_text("changed", encoding="utf-8")
    (folder / "sharp" / "left.dng").unlink()
    assert check_files(folder).differences == (
        f"rig.toml has another content than {CRATE} recorded",
        f"sharp/left.dng is missing ({CRATE} has it)",
    )


@pytest.mark.parametrize("text", ["", "[]", '{"@graph": 3}', '{"@graph": [{"sha256": "1"}]}', "\udcff"])
def test_a_crate_that_cannot_be_read_is_named(folder: Path, text: str):
    (folder / CRATE).write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(DataError, match=CRATE):
        check_files(folder)


@pytest.mark.parametrize("name", ["/etc/passwd", "../../secret"])
def test_a_crate_cannot_name_files_outside(folder: Path, name: str):
    crate(folder, name)
    with pytest.raises(DataError, match="outside the folder"):
        check_files(folder)


def test_rows_that_differ_are_told_by_column():
    old = {"c1 T1": {"ax_mm": 1.0, "flags": []}, "c1 T2": {"ax_mm": 2.0, "flags": []}, "c1 T3": {"ax_mm": None}}
    new = {"c1 T1": {"ax_mm": 1.0, "flags": []}, "c1 T2": {"ax_mm": None, "flags": ["occluded"]}, "c1 T4": {}}
    assert compare_rows(old, new) == [
        "c1 T2: ax_mm 2.0 is now empty, flags no flag is now occluded",
        "c1 T3 is not measured any more",
        "c1 T4 is new",
    ]


def test_a_column_that_one_version_lacks_is_no_difference():
    assert compare_rows({"a": {"x": 1.0}}, {"a": {"x": 1.0, "new": 2.0}}) == []
