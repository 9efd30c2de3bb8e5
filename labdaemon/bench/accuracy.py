"""The published method and ours on the same rendered frames, through the whole chain from RAW file to millimetres."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from labdaemon.bench.bound import BoundTable, ImageNoise, bound_table
from labdaemon.bench.cases import BASE, AccuracyCase, cases
from labdaemon.bench.pairs import MotionComparison, pair_up, read_truth
from labdaemon.bench.programme import run_cases
from labdaemon.bench.simulator import folder_maker, renderer
from labdaemon.processing import WorkerPool, process_folder

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class CaseResult:
    """A case, measured.

    Attributes
    ----------
    case
        What was rendered.
    ours, published
        Pairs by our method, and by the published one (None where it was not run).
    """

    case: AccuracyCase
    ours: list[MotionComparison]
    published: list[MotionComparison] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AccuracyResult:
    """The whole programme.

    Attributes
    ----------
    seeds
        It was run with.
    cases
        In order; a case's pairs pool all seeds.
    bounds
        The Cramér–Rao bound for the light of the pooled case.
    """

    seeds: tuple[int, ...]
    cases: list[CaseResult]
    bounds: BoundTable


def published_method_available() -> bool:
    """Whether the published method is part of this installation."""
    return find_spec("labdaemon.blur.mccarthy2016.method") is not None


def run_accuracy(
    seeds: tuple[int, ...],
    *,
    quick: bool = False,
    only: frozenset[str] | None = None,
    keep: Path | None = None,
    workers: int = 0,
    report: Progress = lambda _: None,
) -> AccuracyResult:
    """Render and measure.

    Parameters
    ----------
    seeds
        Of the simulator; each renders the whole programme anew.
    quick
        One frame a case, and fewer cases.
    only
        Keys of the cases to run; None for all.
    keep
        Where to leave the rendered folders; None to throw them away.
    workers
        Processes, 0 for one a core.
    report
        Called at each case's completion.

    Raises
    ------
    UsageError
        No simulator is installed.
    """
    folder_maker()
    programme = [case for case in cases(quick) if only is None or case.key in only]
    results = [CaseResult(case, [], [] if case.paper and published_method_available() else None) for case in programme]
    with WorkerPool(workers) as pool, _place(keep) as root:
        tables = _start_bounds(pool)
        for result, folder in run_cases(pool, root, seeds, results, render_case, report):
            truth = read_truth(folder)
            result.ours.extend(pair_up(truth, _envelope(folder, pool, "fit")))
            if result.published is not None:
                result.published.extend(pair_up(truth, _envelope(folder, pool, "paper")))
            if keep is None:
                _forget_frames(folder)
        bounds = _finish_bounds(tables)
    return AccuracyResult(seeds, results, bounds)


def render_case(case: AccuracyCase, seed: int, folder: Path) -> Path:
    """Render one case; a worker's task."""
    return folder_maker()(folder, **case.folder_options(seed))


def diameter_bounds(diameter_mm: float) -> BoundTable:
    """The bound for dots of one size; a worker's task."""
    return bound_table(renderer(), (diameter_mm,), ImageNoise())


def _start_bounds(pool: WorkerPool) -> list[Future[BoundTable]]:
    return [pool.submit(diameter_bounds, diameter) for diameter in BASE["diameters_mm"]]


def _finish_bounds(tables: list[Future[BoundTable]]) -> BoundTable:
    done = [table.result() for table in tables]
    along = {diameter: sd for table in done for diameter, sd in table.along_mm.items()}
    across = {diameter: sd for table in done for diameter, sd in table.across_mm.items()}
    return BoundTable(done[0].amplitude_mm, along, across)


def _envelope(folder: Path, pool: WorkerPool, method: str) -> Iterable[dict[str, Any]]:
    result = process_folder(folder, folder / f"results-{method}", pool=pool, method=method)
    return [dict(row) for capture in result.captures for row in capture.envelope_rows]


def _forget_frames(folder: Path) -> None:
    """Frames are 20 MB each and the programme has a hundred."""
    for frame in folder.rglob("*.dng"):
        frame.unlink()


def _place(keep: Path | None) -> Any:
    if keep is None:
        return _TemporaryPlace()
    return nullcontext(keep)


class _TemporaryPlace(tempfile.TemporaryDirectory[str]):
    def __enter__(self) -> Path:  # type: ignore[override]
        return Path(super().__enter__())
