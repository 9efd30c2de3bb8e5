"""Measures stored captures in worker processes, and keeps a campaign's result files."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from pathlib import Path

from labdaemon.campaign.measuring import Measured, Rows
from labdaemon.journal.frames import part_of, seal
from labdaemon.journal.storage import as_data_error
from labdaemon.processing import SharpSet, WorkerPool, measure_capture, prepare_sharp
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, csv_text

SHARP_SETS_KEPT = 4
"""Prepared sharp sets in memory: the one in use, the one before it while its last captures are measured, and the first
one of each campaign, whose names the others keep."""


class PoolMeasurer:
    """A `labdaemon.campaign.measuring.Measurer` on a worker pool.

    Parameters
    ----------
    pool
        The workers; they are given paths, not pictures.
    """

    def __init__(self, pool: WorkerPool) -> None:
        self._pool = pool
        self._prepared: dict[tuple[Path, str | None], asyncio.Task[SharpSet]] = {}

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> Measured:
        """Measure captures of a data-set folder jointly; a sharp set is prepared once for all of its captures.

        Raises
        ------
        DataError, ConfigError
            A frame cannot be read, or killed its worker twice; the sharp set does not carry enough control targets.
        """
        sharp_set = await self._sharp_set(folder, sharp)
        result = await asyncio.wrap_future(self._pool.submit(measure_capture, folder, sharp_set, tuple(captures), name))
        return Measured(list(result.envelope_rows), list(result.measurement_rows))

    async def write_results(self, folder: Path, results: Iterable[Measured]) -> None:
        """Write both result files anew, durably."""
        await asyncio.to_thread(_write, folder, results)

    async def append_results(self, folder: Path, result: Measured) -> None:
        """Add one result's rows to both files."""
        await asyncio.to_thread(_append, folder, result)

    async def _sharp_set(self, folder: Path, sharp: str | None) -> SharpSet:
        key = (folder, sharp)
        task = self._prepared.get(key)
        if task is None or (task.done() and (task.cancelled() or task.exception() is not None)):
            while len(self._prepared) >= SHARP_SETS_KEPT:
                del self._prepared[next(iter(self._prepared))]
            task = asyncio.create_task(self._prepare(folder, sharp))
            self._prepared[key] = task
        return await asyncio.shield(task)

    async def _prepare(self, folder: Path, sharp: str | None) -> SharpSet:
        first = await asyncio.to_thread(_first_set, folder)
        like = await self._sharp_set(folder, first) if sharp != first else None
        return await asyncio.wrap_future(self._pool.submit(prepare_sharp, folder, sharp, like=like))


def _first_set(folder: Path) -> str | None:
    """The set whose names for the targets all others keep: the flat one where there is one, else the first by name."""
    root = folder / "sharp"
    if not root.is_dir() or any(path.is_file() for path in root.iterdir()):
        return None
    return min((path.name for path in root.iterdir()), default=None)


FILES = (("envelope.csv", ENVELOPE_COLUMNS), ("measurements.csv", MEASUREMENT_COLUMNS))


def _write(folder: Path, results: Iterable[Measured]) -> None:
    paths = [folder / "results" / name for name, _ in FILES]
    try:
        with (
            part_of(paths[0]).open("w", encoding="utf-8") as first,
            part_of(paths[1]).open("w", encoding="utf-8") as other,
        ):
            for file, (_, columns) in zip((first, other), FILES, strict=True):
                file.write(csv_text(columns, []))
            for result in results:
                first.write(_lines(ENVELOPE_COLUMNS, result.envelope))
                other.write(_lines(MEASUREMENT_COLUMNS, result.measurements))
    except OSError as exc:
        raise as_data_error(exc, folder) from exc
    for path in paths:
        seal(path)


def _append(folder: Path, result: Measured) -> None:
    """Lines at a file's end; a crash halfway is mended from the journal at the next start."""
    for (name, columns), rows in zip(FILES, (result.envelope, result.measurements), strict=True):
        path = folder / "results" / name
        try:
            with path.open("a", encoding="utf-8") as file:
                file.write(_lines(columns, rows))
        except OSError as exc:
            raise as_data_error(exc, path) from exc


def _lines(columns: Sequence[str], rows: Rows) -> str:
    return csv_text(columns, rows).partition("\n")[2]
