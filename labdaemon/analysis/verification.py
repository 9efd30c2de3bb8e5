"""Is a data-set folder what it was, and do its frames still give its numbers? What `labdaemon verify` does.

Two questions with separate answers: whether each file has the SHA-256 that was recorded when it was stored (in the
journal of the daemon) or described (in `ro-crate-metadata.json`), and whether measuring the frames again gives every
number of the result files to the last digit.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from labdaemon.errors import DataError
from labdaemon.file_hash import sha256_of
from labdaemon.journal.journal import FILE_NAME
from labdaemon.processing import NOT_FRAMES, RESULTS, Row, WorkerPool, process_folder, read_csv

CRATE = "ro-crate-metadata.json"
"""Description of a data-set folder, at its root (RO-Crate 1.1)."""
KEYS: dict[str, tuple[str, ...]] = {
    "envelope.csv": ("capture", "target"),
    "measurements.csv": ("capture", "camera", "target"),
}
"""Result files and the columns that name a row."""


@dataclass(frozen=True, slots=True)
class FileCheck:
    """Files against the hashes that were recorded.

    Attributes
    ----------
    sources
        Where hashes were found: "journal", "ro-crate-metadata.json".
    checked
        Files whose hash was recorded.
    differences
        One line for each file that is missing or has another content.
    unrecorded
        Frames of which no hash was recorded.
    """

    sources: tuple[str, ...]
    checked: int
    differences: tuple[str, ...]
    unrecorded: int


@dataclass(frozen=True, slots=True)
class ValueCheck:
    """Numbers of the result files against a new measurement of the frames.

    Attributes
    ----------
    rows
        Rows compared.
    differences
        One line for each row that differs.
    """

    rows: int
    differences: tuple[str, ...]


def check_files(folder: Path) -> FileCheck:
    """Compare the files of a data-set folder with the hashes recorded of them.

    Raises
    ------
    DataError
        The folder, its crate or a file cannot be read.
    """
    if not os.path.isdir(folder):
        raise DataError("is not a folder", file=folder)
    recorded = {"journal": _journal_hashes(folder), CRATE: _crate_hashes(folder)}
    differences, checked = [], set()
    for source, hashes in recorded.items():
        for name, sha256 in hashes.items():
            path = folder / name
            checked.add(name)
            if not os.path.isfile(path):
                differences.append(f"{name} is missing ({source} has it)")
            elif _digest(path) != sha256:
                differences.append(f"{name} has another content than {source} recorded")
    frames = {path.relative_to(folder).as_posix() for path in _frames(folder)}
    sources = tuple(source for source, hashes in recorded.items() if hashes)
    return FileCheck(sources, len(checked), tuple(sorted(differences)), len(frames - checked))


def check_values(folder: Path, *, results: Path | None = None, pool: WorkerPool | None = None) -> ValueCheck:
    """Measure all frames again and compare every number with the result files; nothing in the folder is written to.

    Raises
    ------
    DataError, ConfigError
        There are no results, or the folder cannot be processed.
    """
    stored = {name: _rows(_existing((results or folder / RESULTS) / name), keys) for name, keys in KEYS.items()}
    with TemporaryDirectory(prefix="labdaemon-verify-") as place:
        process_folder(folder, Path(place), pool=pool)
        renewed = {name: _rows(Path(place) / name, keys) for name, keys in KEYS.items()}
    differences = [f"{name}: {line}" for name in KEYS for line in compare_rows(stored[name], renewed[name])]
    return ValueCheck(sum(len(rows) for rows in stored.values()), tuple(differences))


def compare_rows(stored: Mapping[str, Row], renewed: Mapping[str, Row]) -> list[str]:
    """One line for each row that is missing or has another value; the columns that both have are compared."""
    lines = [f"{key} is not measured any more" for key in stored if key not in renewed]
    lines += [f"{key} is new" for key in renewed if key not in stored]
    for key in stored.keys() & renewed.keys():
        old, new = stored[key], renewed[key]
        changed = [column for column in old if column in new and old[column] != new[column]]
        if changed:
            parts = ", ".join(f"{column} {_text(old[column])} is now {_text(new[column])}" for column in changed[:3])
            more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            lines.append(f"{key}: {parts}{more}")
    return sorted(lines)


def _text(value: object) -> str:
    if value is None:
        return "empty"
    return (";".join(value) or "no flag") if isinstance(value, list) else str(value)


def _existing(path: Path) -> Path:
    if not os.path.isfile(path):
        raise DataError("is not there; run `labdaemon process` on the folder first", file=path)
    return path


def _rows(path: Path, keys: tuple[str, ...]) -> dict[str, Row]:
    return {" ".join(str(row[key]) for key in keys): row for row in read_csv(path)}


def _frames(folder: Path) -> list[Path]:
    found = [path for base in ("sharp", "captures") for path in (folder / base).rglob("*")]
    return [path for path in found if path.is_file() and path.suffix.lower() not in NOT_FRAMES]


def _digest(path: Path) -> str:
    try:
        return sha256_of(path)
    except OSError as exc:
        raise DataError(f"cannot be read ({exc.strerror})", file=path) from None


def _journal_hashes(folder: Path) -> dict[str, str]:
    """Hashes of the journal next to the campaign's folder, by path inside the folder; empty where there is none."""
    root = folder.resolve()
    data = root.parent.parent
    if not os.path.isfile(data / FILE_NAME):
        return {}
    sql = "SELECT path, sha256 FROM frames WHERE campaign = ?"
    try:
        with closing(sqlite3.connect(f"{(data / FILE_NAME).as_uri()}?mode=ro", 2.0, uri=True)) as journal:
            rows = journal.execute(sql, (root.name,)).fetchall()
    except sqlite3.Error as exc:
        raise DataError(f"cannot be read ({exc})", file=data / FILE_NAME) from None
    inside = root.relative_to(data).as_posix() + "/"
    return {str(path).removeprefix(inside): str(sha256) for path, sha256 in rows if str(path).startswith(inside)}


def _crate_hashes(folder: Path) -> dict[str, str]:
    """Hashes of `ro-crate-metadata.json`, by path inside the folder; empty where there is none."""
    path = folder / CRATE
    if not os.path.exists(path):
        return {}
    try:
        graph: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["@graph"]
        files = {str(one["@id"]): str(one["sha256"]) for one in graph if "sha256" in one}
    except (OSError, ValueError, KeyError, TypeError) as exc:
        raise DataError(f"is no RO-Crate that can be read ({exc})", file=path) from None
    outside = [name for name in files if name.startswith("/") or ".." in Path(name).parts]
    if outside:
        raise DataError(f"names a file outside the folder: {outside[0]}", file=path)
    return files
