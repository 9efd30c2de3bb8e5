"""A bench's programme: every case under every seed, in the pool of workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from labdaemon.processing import WorkerPool


class CaseOutcome(Protocol):
    """What a case gives, pooled over seeds."""

    @property
    def case(self) -> Any:
        """The case: it has a `key` and a `title`."""
        ...


Outcome = TypeVar("Outcome", bound=CaseOutcome)
Value = TypeVar("Value")


def run_cases(
    pool: WorkerPool,
    root: Path,
    seeds: Sequence[int],
    outcomes: Sequence[Outcome],
    task: Callable[[Any, int, Path], Value],
    report: Callable[[str], None],
) -> Iterator[tuple[Outcome, Value]]:
    """Run a task for each case under each seed; each value comes with the outcome that it belongs to.

    Parameters
    ----------
    pool, root
        The workers, and where each task has a folder of its own.
    seeds, outcomes
        Of the programme.
    task
        Takes the case, the seed and the folder.
    report
        Called when a value has been used.
    """
    tasks = [
        (seed, one, pool.submit(task, one.case, seed, root / f"{one.case.key}-{seed}"))
        for seed in seeds
        for one in outcomes
    ]
    for seed, one, running in tasks:
        yield one, running.result()
        report(f"seed {seed}: {one.case.title}")
