"""`labdaemon measure`: sharp and blurred frames, motion in pixels, no geometry."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from labdaemon.cli.exposure_options import exposure_options, exposure_windows
from labdaemon.cli.progress_bars import ProgressBars, print_notes
from labdaemon.errors import UsageError
from labdaemon.processing import (
    MEASUREMENT_COLUMNS,
    Row,
    csv_text,
    measure_frames,
    measurement_row,
    name_dots,
    prepare_camera,
    prepare_patches,
    write_csv,
)
from labdaemon.report.overlay import overlay_path, write_overlay

Box = tuple[int, int, int, int]


class PatchParameter(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """X,Y,W,H in whole pixels."""

    name = "X,Y,W,H"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        """Read four numbers."""
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*", str(value))
        if match is None or "0" in match.groups()[2:]:
            self.fail(f"{value!r} is not X,Y,W,H in whole pixels, as 120,80,40,40", param, ctx)
        return tuple(int(number) for number in match.groups())


_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command()
@click.argument("blurred", nargs=-1, required=True, type=_FILE)
@click.option("--sharp", multiple=True, required=True, type=_FILE, help="Sharp frame; several are averaged.")
@click.option("--patch", "patches", multiple=True, type=PatchParameter(), help="Measure this part, whatever it shows.")
@click.option("--out", type=_FILE, help="CSV file to write; standard output if not given.")
@click.option("--method", type=click.Choice(["fit", "paper"]), default="fit", show_default=True)
@exposure_options
@click.option("--overlay", type=click.Path(file_okay=False, path_type=Path), help="Folder for overlay images.")
def measure(
    blurred: tuple[Path, ...],
    sharp: tuple[Path, ...],
    patches: tuple[Box, ...],
    out: Path | None,
    method: str,
    overlay: Path | None,
    phase_rad: tuple[float, ...],
    light: tuple[str, ...],
    **exposure: float | None,
) -> None:
    """Measure every dot of the sharp frame (or each --patch of it) in the BLURRED frames, in pixels."""
    windows, grouped = exposure_windows(blurred, phase_rad, light, **exposure)
    stems = Counter(path.stem for path in blurred)
    twice = [stem for stem, times in stems.items() if times > 1]
    if twice:
        raise UsageError(f"two blurred frames are called {twice[0]}; rename one, their names go into the results")
    console = Console(stderr=True)
    with ProgressBars(console) as bars:
        bars("sharp frames", 0, 1)
        if patches:
            camera = prepare_patches(sharp, patches)
        else:
            camera = name_dots(prepare_camera("", sharp, keep_dots=method == "paper"))
        bars("sharp frames", 1, 1)
        rows: list[Row] = []
        notes = list(camera.notes)
        together = [(blurred, windows)] if grouped else [((f,), [w]) for f, w in zip(blurred, windows, strict=True)]
        for done, (files, known) in enumerate(together, start=1):
            result = measure_frames(camera, files, known, method=method)
            name = "+".join(path.stem for path in files)
            mine = [measurement_row(name, "", one) for one in result.measurements]
            rows += mine
            notes += result.notes
            if overlay is not None:
                write_overlay(files[-1], mine, overlay_path(overlay, name, ""), name)
            bars("blurred frames", done, len(together))
    if out is None:
        click.echo(csv_text(MEASUREMENT_COLUMNS, rows), nl=False)
    else:
        write_csv(out, MEASUREMENT_COLUMNS, rows)
    _summary(rows, console, out)
    print_notes(console, notes)


def _summary(rows: list[Row], console: Console, out: Path | None) -> None:
    """A line a frame."""
    table = Table("frame", "targets", "clean", "flags", "semi-amplitude px", "median sd px", box=None, pad_edge=False)
    for capture in dict.fromkeys(str(row["capture"]) for row in rows):
        mine = [row for row in rows if row["capture"] == capture]
        seen = [row for row in mine if isinstance(row["ax_px"], float)]
        lengths = [np.hypot(float(str(row["ax_px"])), float(str(row["ay_px"]))) for row in seen]
        sds = [np.hypot(float(str(row["sd_ax_px"])), float(str(row["sd_ay_px"]))) / np.sqrt(2) for row in seen]
        flags = Counter(flag for row in mine if isinstance(row["flags"], list) for flag in row["flags"])
        table.add_row(
            capture,
            str(len(mine)),
            str(sum(not row["flags"] for row in mine)),
            ", ".join(f"{count} {flag}" for flag, count in flags.items()),
            f"{min(lengths):.2f} – {max(lengths):.2f}" if lengths else "none",
            f"{np.median(sds):.3f}" if sds else "",
        )
    console.print(table)
    if out is not None:
        console.print(f"results in {out}", highlight=False, soft_wrap=True)
