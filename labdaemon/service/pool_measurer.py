"""Measures stored captures in worker processes, and keeps a campaign's result files."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

from labdaemon.campaign.measurement_queue import CaptureRows
from labdaemon.errors import ConfigError, DataError, LabdaemonError, SetupError
from labdaemon.off_loop import off_loop
from labdaemon.processing import SharpSet, WorkerPool, check_frame_sizes, measure_capture, prepare_sharp, sharp_sets
from labdaemon.service.result_files import ResultFiles, captures_in, stamp

SHARP_SETS_KEPT = 4
"""Prepared sharp sets in memory: the one in use, the one before it while its last captures are measured, and the first
one of each campaign, whose names the others keep."""

log: logging.Logger = logging.getLogger(__name__)


class PoolMeasurer:
    """A `labdaemon.campaign.measurement_queue.CaptureMeasurer` on a worker pool.

    Parameters
    ----------
    pool
        The workers; they get paths, not images.
    """

    def __init__(self, pool: WorkerPool) -> None:
        self._pool = pool
        self._files = ResultFiles()
        self._prepared: dict[tuple[Path, str | None], asyncio.Task[SharpSet]] = {}

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        """Measure captures of a data-set folder jointly; a sharp set is prepared once for all of its captures.

        Raises
        ------
        DataError, ConfigError
            A frame cannot be read, or killed its worker twice; the sharp set does not carry enough control targets.
        """
        sharp_set = await self._sharp_set(folder, sharp)
        result = await asyncio.wrap_future(self._pool.submit(measure_capture, folder, sharp_set, tuple(captures), name))
        for note in result.notes:
            log.warning("%s: %s", name, note)
        return CaptureRows(list(result.envelope_rows), list(result.measurement_rows))

    async def check_frames(self, folder: Path, frames: Sequence[tuple[str, Path]]) -> None:
        """Compare the sizes of a campaign's first frames with its rig file.

        Without frames it only starts a worker, which takes seconds: the campaign then need not wait for that.

        Raises
        ------
        SetupError
            They differ.
        """
        try:
            await asyncio.wrap_future(self._pool.submit(check_frame_sizes, folder, list(frames)))
        except SetupError:
            raise
        except LabdaemonError:
            return  # a frame that takes its worker with it is no question of the set-up; measuring reports it

    def write_results(self, folder: Path, results: Iterable[CaptureRows]) -> None:
        """Write both result files anew, durably."""
        self._files.write(folder, results)

    def append_results(self, folder: Path, result: CaptureRows) -> bool:
        """Add one result's rows to both files; False where another program has changed them."""
        return self._files.append(folder, result)

    def lacks(self, folder: Path, names: set[str], kept: str | None) -> bool:
        """Whether the files have changed and lack a result that they once had."""
        # A folder that a person has removed stays removed.
        return folder.is_dir() and stamp(folder) != kept and not names <= captures_in(folder)

    def stamp(self, folder: Path) -> str:
        """The files' state, for `lacks`."""
        return stamp(folder)

    async def _sharp_set(self, folder: Path, sharp: str | None) -> SharpSet:
        key = (folder, sharp)
        task = self._prepared.get(key)
        if task is None or (task.done() and (task.cancelled() or task.exception() is not None)):
            while len(self._prepared) >= SHARP_SETS_KEPT:
                del self._prepared[next(iter(self._prepared))]
            task = asyncio.create_task(self._prepare(folder, sharp))
        else:
            del self._prepared[key]  # the one that was used last is dropped last
        self._prepared[key] = task
        return await asyncio.shield(task)

    async def _naming_set(self, folder: Path, sharp: str | None) -> SharpSet | None:
        """The first sharp set that can be used, whose names for the targets all later ones keep; as `process` does."""
        for name in await off_loop(sharp_sets, folder):
            if name == (sharp or ""):
                return None
            try:
                return await self._sharp_set(folder, name or None)
            except (DataError, ConfigError):
                continue  # a sharp set that failed and was taken again
        return None

    async def _prepare(self, folder: Path, sharp: str | None) -> SharpSet:
        like = await self._naming_set(folder, sharp)
        return await asyncio.wrap_future(self._pool.submit(prepare_sharp, folder, sharp, like=like))
