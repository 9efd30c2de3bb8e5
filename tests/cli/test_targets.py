from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from labdaemon.cli.targets import read_ids, targets
from labdaemon.errors import UsageError


def run(*arguments: str) -> str:
    result = CliRunner().invoke(targets, list(arguments), catch_exceptions=False, standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.output


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--kind", "dots", "--count", "5"], "5 dots of 8 mm on 1 page of a4"),
        (["--kind", "tags", "--ids", "0-14", "--paper", "a3"], "15 tags of 36 mm on 1 page of a3"),
        (["--kind", "tags", "--ids", "0-14"], "15 tags of 36 mm on 2 pages of a4"),
        (["--kind", "rings", "--ids", "3,5", "--bits", "14", "--size-mm", "6"], "2 rings of 6 mm on 1 page of a4"),
        (["--kind", "rings"], "rings of 10 mm on 1 page"),
    ],
)
def test_sheets_are_written(tmp_path: Path, arguments: list[str], says: str) -> None:
    out = tmp_path / "sheet.pdf"
    assert says in run(*arguments, "--out", str(out))
    assert out.read_bytes().startswith(b"%PDF-1.4")
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.pdf"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--kind", "tags", "--ids", "0,587"], "0 to 586"),
        (["--kind", "tags", "--family", "qr"], "apriltag-36h11"),
        (["--kind", "dots", "--ids", "3"], "--count"),
        (["--kind", "rings", "--count", "3"], "--ids"),
        (["--kind", "dots", "--size-mm", "100"], "does not fit"),
        (["--kind", "tags", "--label-mm", "36"], "no white"),
    ],
)
def test_bad_requests_write_nothing(tmp_path: Path, arguments: list[str], says: str) -> None:
    out = tmp_path / "sheet.pdf"
    with pytest.raises(UsageError, match=says):
        run(*arguments, "--out", str(out))
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere/sheet\.pdf cannot be written"):
        run("--out", str(tmp_path / "nowhere" / "sheet.pdf"))


def test_ids_are_numbers_and_ranges() -> None:
    assert read_ids("0-3, 9,12") == [0, 1, 2, 3, 9, 12]
    for text, says in [("3-1", "1-3"), ("a", "0-5,9"), ("", "0-5,9"), ("1,1", "twice"), ("0-99999", "too many")]:
        with pytest.raises(UsageError, match=says):
            read_ids(text)
