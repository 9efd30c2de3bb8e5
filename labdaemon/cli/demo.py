"""`labdaemon demo`: the main job without hardware, measured against a truth that only the simulator knows."""

from __future__ import annotations

import math
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click

from labdaemon.errors import UsageError
from labdaemon.report.accuracy import FLOOR_MM, Accuracy, summary


@click.command()
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Where to leave everything. [default: labdaemon-demo]",
)
def demo(out: Path | None) -> None:
    """Photographs of a shaken frame are rendered, measured and compared with the truth. Needs no hardware."""
    from labdaemon.processing import process_folder
    from labdaemon.report.accuracy import read_truth
    from labdaemon.report.folder_page import report_folder

    folder = free_folder(out)
    click.echo(f"Rendering photographs into {folder} …")
    simulator("folder")(folder, captures=2)
    click.echo("Measuring …")
    process_folder(folder)
    page, accuracies = report_folder(
        folder, title="labdaemon demo", subtitle="Rendered photographs", truth=read_truth(folder / "truth.csv")
    )
    for line in accuracy_lines(accuracies):
        click.echo(line)
    click.echo(f"Results: {folder / 'results'}\nReport:  {page}")


def simulator(name: str) -> Any:
    """What the entry point group ``labdaemon.simulators`` has under a name.

    Raises
    ------
    UsageError
        The simulators are not installed.
    """
    found = entry_points(group="labdaemon.simulators")
    if name not in found.names:
        raise UsageError(f"the simulators are not installed (no entry point labdaemon.simulators:{name})")
    return found[name].load()


def free_folder(asked: Path | None) -> Path:
    """An empty folder: the one asked for, or ``labdaemon-demo`` with a number if that is taken.

    Raises
    ------
    UsageError
        The one asked for holds something already.
    """
    if asked is None:
        base, number = Path("labdaemon-demo"), 1
        asked = base
        while asked.exists():
            number += 1
            asked = Path(f"{base}-{number}")
    elif asked.exists() and any(asked.iterdir()):
        raise UsageError(f"{asked} is not empty; give --out a new folder")
    try:
        asked.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise UsageError(f"{asked} cannot be made: {exc.strerror}") from None
    return asked.resolve()


def accuracy_lines(accuracies: Iterable[Accuracy]) -> list[str]:
    """A table of errors in text, pooled in its last line."""
    known = list(accuracies)
    pooled = summary("all", [pair for one in known for pair in one.pairs])
    head = f"{'capture':<22}{'targets':>8}{'unflagged':>10}{'compared':>9}{'mean mm':>10}{'sd mm':>9}{'95 % mm':>9}"
    lines = [
        f"{one.capture:<22}{one.targets:>8}{one.unflagged:>10}{one.compared:>9}"
        f"{_number(one.mean_mm, '+.4f'):>10}{_number(one.sd_mm, '.4f'):>9}{_number(one.p95_mm, '.4f'):>9}"
        for one in [*known, pooled]
    ]
    return [f"Error of semi-amplitudes of {FLOOR_MM:g} mm and more against the simulator's truth:", head, *lines]


def _number(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)
