"""`results/gauges.csv`: what each gauge saw during each capture, one row for each.

The journal is what counts for a campaign; `labdaemon process` makes the same file from each `capture.toml`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from labdaemon.durable import append_durably, write_durably
from labdaemon.events import GaugeMotion

FILE_NAME = "gauges.csv"
GAUGE_COLUMNS = ("capture", *GaugeMotion.model_fields)
Rows = Iterable[tuple[str, GaugeMotion]]
"""Name of a capture, and what one gauge saw during it."""


def gauges_text(rows: Rows, *, header: bool = True) -> str:
    """The file's text: nine significant digits, empty where there is no number."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    if header:
        writer.writerow(GAUGE_COLUMNS)
    for capture, motion in rows:
        values = motion.model_dump()
        writer.writerow([capture, *(_cell(values[column]) for column in GAUGE_COLUMNS[1:])])
    return out.getvalue()


def _cell(value: str | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def write_gauges(results: Path, rows: Sequence[tuple[str, GaugeMotion]]) -> None:
    """Write the file whole or not at all; none is made where no gauge saw anything.

    Raises
    ------
    StorageError
        The folder cannot be written.
    """
    path = results / FILE_NAME
    if rows or path.exists():
        write_durably(path, gauges_text(rows))


class GaugeFiles:
    """The files of campaigns' folders: rows are added as captures are stored, and written anew where that is not sure.

    Everything here blocks.
    """

    def __init__(self) -> None:
        self._captures: dict[Path, set[str]] = {}
        self._left: dict[Path, tuple[int, int, int]] = {}

    def write(self, results: Path, rows: Sequence[tuple[str, GaugeMotion]]) -> None:
        """Write a file anew."""
        self._left.pop(results, None)
        write_gauges(results, rows)
        self._captures[results] = {capture for capture, _ in rows}
        self._remember(results)

    def add(
        self,
        results: Path,
        capture: str,
        motions: Sequence[GaugeMotion],
        all_rows: Callable[[], Sequence[tuple[str, GaugeMotion]]],
    ) -> None:
        """Add a capture's rows; once, whatever is asked. A file that another program has changed is written anew.

        Parameters
        ----------
        results
            The folder of the file.
        capture, motions
            The capture, and what each gauge saw.
        all_rows
            What the file is to hold in the end, for writing it anew.

        Raises
        ------
        StorageError
            The folder cannot be written.
        """
        if not motions or capture in self._captures.get(results, set()):
            return
        left = self._left.pop(results, None)
        if left is None or left != _stamp(results / FILE_NAME):
            self.write(results, all_rows())
            return
        append_durably(results / FILE_NAME, gauges_text(((capture, one) for one in motions), header=False).encode())
        self._captures[results].add(capture)
        self._remember(results)

    def _remember(self, results: Path) -> None:
        stamp = _stamp(results / FILE_NAME)
        if stamp is not None:
            self._left[results] = stamp


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        about = path.stat()
    except OSError:  # not there (any more): it has no state to compare
        return None
    return about.st_ino, about.st_size, about.st_mtime_ns
