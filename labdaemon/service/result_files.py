"""A campaign's result files as the daemon keeps them: rows added as they are measured, all rows written anew.

The journal is what counts; these files are its copy for people and programs. Everything here blocks.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from labdaemon.campaign.measurement_queue import CaptureRows, Rows
from labdaemon.durable import append_durably, storage_error, whole_file
from labdaemon.processing import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, RESULTS, Stamp, csv_text, stamps
from labdaemon.processing import FILES as NAMES

FILES = tuple(zip(NAMES, (ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS), strict=True))


class ResultFiles:
    """Writes the result files of campaigns' folders, and notices when another program has written to them."""

    def __init__(self) -> None:
        self._left: dict[Path, tuple[Stamp | None, ...]] = {}

    def write(self, folder: Path, results: Iterable[CaptureRows]) -> None:
        """Write both files anew, each whole or not at all.

        Raises
        ------
        StorageError
            The disk refuses it.
        """
        envelope, measurements = (folder / RESULTS / name for name, _ in FILES)
        with whole_file(envelope) as first, whole_file(measurements) as other:
            for file, (_, columns) in zip((first, other), FILES, strict=True):
                file.write(csv_text(columns, []).encode())
            for result in results:
                first.write(_lines(ENVELOPE_COLUMNS, result.envelope))
                other.write(_lines(MEASUREMENT_COLUMNS, result.measurements))
        self._left[folder] = stamps(folder)

    def append(self, folder: Path, result: CaptureRows) -> bool:
        """Add one result's rows, synced; False, and nothing done, where the files are not as this daemon left them.

        Raises
        ------
        StorageError
            The disk refuses it.
        """
        left = self._left.pop(folder, None)
        if left is None or None in left or left != stamps(folder):
            return False
        for (name, columns), rows in zip(FILES, (result.envelope, result.measurements), strict=True):
            append_durably(folder / RESULTS / name, _lines(columns, rows))
        self._left[folder] = stamps(folder)
        return True


def stamp(folder: Path) -> str:
    """The files' state in a word, to be kept: another word later means that they were changed."""
    return repr(stamps(folder))


def captures_in(folder: Path) -> set[str]:
    """Names of the captures and groups that have rows in a folder's ``envelope.csv``; none where it is not there."""
    path = folder / RESULTS / FILES[0][0]
    try:
        # A power cut may leave zero bytes, which csv refuses, or half a character.
        with path.open(encoding="utf-8", errors="replace", newline="") as file:
            return {row["capture"] for row in csv.DictReader(line.replace("\0", "") for line in file)}
    except (csv.Error, KeyError):  # another program has changed it: it is written anew
        return set()
    except FileNotFoundError:  # no result has come yet, or a person has removed it
        return set()
    except OSError as exc:
        raise storage_error(exc, path) from exc


def _lines(columns: Sequence[str], rows: Rows) -> bytes:
    return csv_text(columns, rows).partition("\n")[2].encode()
