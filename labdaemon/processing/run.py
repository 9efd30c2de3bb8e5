"""A whole data-set folder: sharp sets prepared, captures measured in worker processes, results written."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

from labdaemon.durable import check_place
from labdaemon.errors import ConfigError, DataError
from labdaemon.journal.gauge_table import write_gauges
from labdaemon.processing.envelope import CaptureResult, join_frames, measure_in_folder
from labdaemon.processing.folder import DataFolder, check_frequencies, open_folder
from labdaemon.processing.pool import WorkerPool
from labdaemon.processing.results_place import FILES, RESULTS, ResultsFolders
from labdaemon.processing.sharpset import SharpSet, assemble, prepare_in_folder, prepare_sharp
from labdaemon.processing.tables import ENVELOPE_COLUMNS, MEASUREMENT_COLUMNS, write_csv

Progress = Callable[[str, int, int], None]
"""Called with the name of the work in progress, the number of its parts that are done, and of all its parts."""


@dataclass(frozen=True, slots=True)
class Job:
    """One capture, or the captures of one group, and the sharp set they belong to."""

    name: str
    captures: tuple[str, ...]
    sharp: str | None


@dataclass(frozen=True, slots=True)
class FolderResult:
    """What processing a folder gave.

    Attributes
    ----------
    out
        Where the result files are.
    captures
        One result a capture or group.
    sharp_sets
        By name, "" for the flat one.
    note
        Why the result files are not in the usual place; None where they are.
    """

    out: Path
    captures: tuple[CaptureResult, ...]
    sharp_sets: dict[str, SharpSet]
    note: str | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """All notes, of sharp sets and captures."""
        sets = [note for sharp in self.sharp_sets.values() for note in sharp.notes]
        own = () if self.note is None else (self.note,)
        return (*own, *sets, *(note for capture in self.captures for note in capture.notes))


def jobs(folder: DataFolder) -> list[Job]:
    """Captures in order, those of a group together at the place of the group's last one.

    Raises
    ------
    DataError, ConfigError
        A capture's file is missing or wrong, or a group's captures name different sharp sets or frequencies.
    """
    members: dict[str, list[str]] = {}
    kind: dict[str, tuple[bool, str | None]] = {}
    for name in folder.capture_names():
        about = folder.capture(name).about
        report = about.group or name
        is_group, sharp = kind.setdefault(report, (about.group is not None, about.sharp))
        where = folder.root / "captures" / name
        if is_group != (about.group is not None):
            raise DataError(f"{report} is the name of a capture and of a group: rename one", file=where)
        if sharp != about.sharp:
            raise DataError(f"the captures of group {report} name different sharp sets", file=where)
        members[report] = [*members.pop(report, []), name]
    for report, captures in members.items():
        check_frequencies(folder, captures, report)
    return [Job(name, tuple(captures), kind[name][1]) for name, captures in members.items()]


def process_folder(
    folder: Path,
    out: Path | None = None,
    *,
    pool: WorkerPool | None = None,
    method: str | None = None,
    progress: Progress | None = None,
) -> FolderResult:
    """Run the whole chain on a data-set folder and write its result files; `gauges.csv` only where gauges saw anything.

    Parameters
    ----------
    folder
        The data-set folder; only `out` is written to.
    out
        Where to, FOLDER/results if None, or FOLDER/results-2 (-3 …) while another process writes there.
    pool
        Worker processes to use; a pool of its own, one process a core, if None.
    method
        "fit" or "paper"; the rig file's if None.
    progress
        Called with what is done.

    Raises
    ------
    DataError, ConfigError
        The input cannot be used, or the results cannot be written: one line naming the file; nothing is written then.
    """
    opened, place = open_folder(folder), ResultsFolders.of(folder)
    if method is not None:
        settings = opened.rig.processing.model_copy(update={"method": method})
        rig = opened.rig.model_copy(update={"processing": settings})
        opened = replace(opened, rig=rig)
    todo = jobs(opened)
    check_place(out or folder / RESULTS, FILES)
    tell = progress or (lambda _what, _done, _of: None)
    with contextlib.nullcontext(pool) if pool is not None else WorkerPool() as workers:
        sets = _prepare(opened, todo, workers, tell)
        results = _measure(opened, todo, sets, workers, tell)
    target, note = (out, None) if out is not None else place.choose()
    rows = [row for result in results for row in result.measurement_rows]
    write_csv(target / "measurements.csv", MEASUREMENT_COLUMNS, rows)
    rows = [row for result in results for row in result.envelope_rows]
    write_csv(target / "envelope.csv", ENVELOPE_COLUMNS, rows)
    write_gauges(target, [(name, one) for name in opened.capture_names() for one in opened.gauges(name)])
    return FolderResult(target, tuple(results), sets, note)


def _prepare(folder: DataFolder, todo: Sequence[Job], pool: WorkerPool, tell: Progress) -> dict[str, SharpSet]:
    used = {job.sharp or "" for job in todo}
    # In the order in which the daemon prepares them, so that targets get the names that it gave them.
    order = {name: place for place, name in enumerate(folder.sharp_sets())}
    names = sorted(used, key=lambda name: (order.get(name, len(order)), name))
    naming = _naming_set(folder, names[0], pool)
    files = [folder.sharp(name or None) for name in names]
    tasks = [
        (one, camera, pool.submit(prepare_in_folder, folder, one, camera)) for one in files for camera in one.frames
    ]
    _wait([task for *_, task in tasks], "sharp frames", tell)
    sets: dict[str, SharpSet] = {}
    for one in files:
        prepared = [task.result() for its, _, task in tasks if its is one]
        first = naming or next(iter(sets.values()), None)
        # In a worker, since this process may run many threads of linear algebra that only hinder each other.
        sets[one.name] = pool.submit(assemble, folder, one, prepared, like=first).result()
    return sets


def _naming_set(folder: DataFolder, first_used: str, pool: WorkerPool) -> SharpSet | None:
    """A sharp set of before the first one in use, whose names for the targets all others keep; None without any."""
    for name in folder.sharp_sets():
        if name == first_used:
            break
        try:
            return pool.submit(prepare_sharp, folder.root, name or None).result()
        except (DataError, ConfigError):
            continue  # a sharp set that failed and was taken again
    return None


def _measure(
    folder: DataFolder, todo: Sequence[Job], sets: dict[str, SharpSet], pool: WorkerPool, tell: Progress
) -> list[CaptureResult]:
    tasks = [
        [
            pool.submit(measure_in_folder, folder, sets[job.sharp or ""], job.captures, camera.name)
            for camera in sets[job.sharp or ""].cameras
        ]
        for job in todo
    ]
    _wait([task for one in tasks for task in one], "blurred frames", tell)
    joins = [
        pool.submit(join_frames, folder, sets[job.sharp or ""], [task.result() for task in one], job.captures, job.name)
        for job, one in zip(todo, tasks, strict=True)
    ]
    _wait(joins, "envelopes", tell)
    return [join.result() for join in joins]


def _wait(tasks: Sequence[Future], what: str, tell: Progress) -> None:  # type: ignore[type-arg]
    """Wait for all, in order; the first failure stops the rest."""
    tell(what, 0, len(tasks))
    try:
        for done, task in enumerate(tasks, start=1):
            task.result()
            tell(what, done, len(tasks))
    except BaseException:
        for task in tasks:
            task.cancel()
        raise
