"""`labdaemon verify` and `labdaemon noise-floor`: can a folder's files and numbers be trusted?"""

from __future__ import annotations

import os
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from labdaemon.analysis.noise_floor import NoiseFloor, noise_floor
from labdaemon.analysis.verification import check_files, check_values
from labdaemon.errors import DataError
from labdaemon.processing import RESULTS, Row, WorkerPool, read_csv

SHOWN = 10
"""Differences that are printed; the others are counted."""


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), help="FOLDER/results if not given.")
@click.option("--files-only", is_flag=True, help="Compare hashes only; measure nothing.")
@click.option("--workers", type=click.IntRange(min=0), default=0, help="Worker processes; 0 for one a core.")
def verify(folder: Path, results: Path | None, files_only: bool, workers: int) -> int:
    """Check that FOLDER's files are the recorded ones, and that its frames give its numbers again, to the last digit.

    Exit status 1 where anything differs.
    """
    files = check_files(folder)
    if files.sources:
        _report(f"{files.checked} files compared with {' and '.join(files.sources)}", files.differences)
    else:
        click.echo(
            "files: no hash was recorded; `labdaemon export FOLDER --to FOLDER/ro-crate-metadata.json` records them now"
        )
    if files.sources and files.unrecorded:
        click.echo(f"{files.unrecorded} frames have no recorded hash")
    if files_only:
        return 1 if files.differences else 0
    with WorkerPool(workers) as pool:
        values = check_values(folder, results=results, pool=pool)
    _report(f"{values.rows} rows measured again", values.differences)
    return 1 if files.differences or values.differences else 0


def _report(what: str, differences: tuple[str, ...]) -> None:
    click.echo(f"{what}: {f'{len(differences)} differ' if differences else 'all the same'}")
    for line in differences[:SHOWN]:
        click.echo(f"  {line}")
    if len(differences) > SHOWN:
        click.echo(f"  … and {len(differences) - SHOWN} more")


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--capture", "captures", multiple=True, help="A capture at rest; all of the folder if none is given.")
@click.option("--results", type=click.Path(file_okay=False, path_type=Path), help="FOLDER/results if not given.")
def noise_floor_command(folder: Path, captures: tuple[str, ...], results: Path | None) -> None:
    """What the set-up reads at rest: scatter against the stated sd, and the smallest motion that can be detected.

    Take some captures with the table at rest, process them, and give them here. Columns: scatter of a target's position
    between captures, the sd stated for it and their ratio; median of the amplitude, and the limit that 95 % of the
    amplitudes do not exceed: smaller motions look like rest. The sd stated in millimetres contains survey and
    orientation, which all captures share, so that its ratio is far below 1; in pixels it should be near 1 or below.
    """
    place = results or folder / RESULTS
    envelope, measurements = (_chosen(place / name, captures) for name in ("envelope.csv", "measurements.csv"))
    floors = [noise_floor(envelope, "mm", "envelope")]
    for camera in dict.fromkeys(str(row["camera"]) for row in measurements):
        floors.append(noise_floor([row for row in measurements if row["camera"] == camera], "px", camera or "camera"))
    Console().print(_table(floors))
    for floor in floors:
        if floor.false_motion:
            some = ", ".join(floor.false_motion[:SHOWN])
            click.echo(f"{floor.source}: {len(floor.false_motion)} readings without the flag at_rest: {some}")


def _table(floors: list[NoiseFloor]) -> Table:
    names = ("source", "unit", "captures", "targets", "scatter", "stated", "ratio", "median", "limit", "at_rest")
    table = Table(*names, box=None, pad_edge=False)
    for floor in floors:
        numbers = (floor.position_sd, floor.stated_position_sd)
        table.add_row(
            floor.source,
            floor.unit,
            str(floor.captures),
            str(floor.targets),
            *(f"{value:.4f}" for value in numbers),
            f"{floor.position_ratio:.2f}",
            f"{floor.amplitude_median:.4f}",
            f"{floor.detection_limit:.4f}",
            f"{100 * floor.at_rest_share:.0f} %",
        )
    return table


def _chosen(path: Path, captures: tuple[str, ...]) -> list[Row]:
    if not os.path.isfile(path):
        raise DataError("is not there; run `labdaemon process` on the folder first", file=path)
    rows = read_csv(path)
    known = {str(row["capture"]) for row in rows}
    missing = [name for name in captures if name not in known]
    if missing:
        raise DataError(f"has no capture {missing[0]!r}; it has {', '.join(sorted(known))}", file=path)
    return [row for row in rows if not captures or row["capture"] in captures]
