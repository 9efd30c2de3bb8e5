"""What lies in a folder, and what is no file."""

import os
from pathlib import Path

import pytest

from labdaemon.errors import DataError
from labdaemon.plain_file import check_plain_file, entries


def test_entries_in_order_with_links_that_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "a.dng").touch()
    (tmp_path / "c").symlink_to(tmp_path / "c")
    (tmp_path / "d").symlink_to(tmp_path / "b")
    expected = [("a.dng", False), ("b", True), ("c", False), ("d", True)]
    assert [(path.name, is_folder) for path, is_folder in entries(tmp_path)] == expected


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path) -> None:
    (tmp_path / "captures").touch()
    with pytest.raises(DataError, match=r"captures: the folder cannot be read \(Not a directory\)"):
        entries(tmp_path / "captures")


def test_a_pipe_and_a_folder_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path(os.devnull)):
        with pytest.raises(DataError, match="it is no file"):
            check_plain_file(path)
    check_plain_file(tmp_path / "absent")
