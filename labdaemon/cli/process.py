"""`labdaemon process`: the whole chain on a data-set folder."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from labdaemon.cli.progress_bars import ProgressBars, print_notes
from labdaemon.orbit_size import size_mm
from labdaemon.processing import CaptureResult, FolderResult, WorkerPool, process_folder
from labdaemon.report.overlay import write_overlays


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Where to write; FOLDER/results if not given."
)
@click.option("--workers", type=click.IntRange(min=0), default=0, help="Worker processes; 0 for one a core.")
@click.option("--method", type=click.Choice(["fit", "paper"]), help="The rig file's, or fit, if not given.")
@click.option("--overlay/--no-overlay", default=True, help="Draw the vectors on each frame.")
def process(folder: Path, out: Path | None, workers: int, method: str | None, overlay: bool) -> None:
    """Measure all captures of a data-set FOLDER: measurements.csv in pixels, envelope.csv in millimetres, overlays."""
    console = Console(stderr=True)
    with WorkerPool(workers) as pool, ProgressBars(console) as bars:
        result = process_folder(folder, out, pool=pool, method=method, progress=bars)
        if overlay:
            tasks = write_overlays(folder, result, pool.submit)
            for done, task in enumerate(tasks, start=1):
                task.result()
                bars("overlays", done, len(tasks))
    _summary(result, console)


def _summary(result: FolderResult, console: Console) -> None:
    """A line a capture, what is worth knowing, and where the results lie."""
    table = Table("capture", "targets", "clean", "flags", "amplitude mm", "median sd mm", box=None, pad_edge=False)
    for column in (1, 2, 4, 5):
        table.columns[column].justify = "right"
    for capture in result.captures:
        table.add_row(*_line(capture))
    Console().print(table)
    print_notes(console, result.notes)
    click.echo(f"results in {result.out}")


def _line(capture: CaptureResult) -> list[str]:
    rows = capture.envelope_rows
    lengths = [length for row in rows if (length := size_mm(row)) is not None]
    sds = [row["sd_ax_mm"] for row in rows if isinstance(row["sd_ax_mm"], float)]
    flags = Counter(flag for row in rows if isinstance(row["flags"], list) for flag in row["flags"])
    span = f"{min(lengths):.3f} – {max(lengths):.3f}" if lengths else "none"
    return [
        capture.name,
        str(len(rows)),
        str(sum(not row["flags"] for row in rows)),
        ", ".join(f"{count} {flag}" for flag, count in flags.items()),
        span,
        f"{np.median(sds):.4f}" if sds else "",
    ]
