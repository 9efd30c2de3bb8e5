"""`labdaemon targets`: sheets of dots, tags and rings to print."""

from __future__ import annotations

import re
from pathlib import Path

import click

from labdaemon.durable import write_durably
from labdaemon.errors import StorageError, UsageError
from labdaemon.report import sheets


def read_ids(text: str) -> list[int]:
    """Numbers of `0-5,9,12`, in that order.

    Raises
    ------
    UsageError
        It is written otherwise, or a number comes twice.
    """
    numbers: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if match is None:
            raise UsageError(f"--ids {text!r} is not numbers and ranges, as 0-5,9,12")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise UsageError(f"--ids {part.strip()} runs backwards; write {last}-{first}")
        if last - first >= 10_000:
            raise UsageError(f"--ids {part.strip()} are too many for sheets of paper")
        numbers += range(first, last + 1)
    twice = sorted({n for n in numbers if numbers.count(n) > 1})
    if twice:
        raise UsageError(f"--ids names {twice[0]} twice; two prints of one code in view are refused when measuring")
    return numbers


@click.command()
@click.option("--kind", type=click.Choice(["dots", "tags", "rings"]), default="dots", show_default=True)
@click.option(
    "--size-mm",
    type=click.FloatRange(min=0.5, max=400),
    help="Diameter of a dot (also a ring's), side of a tag's black square. [default: 8 dots, 36 tags, 10 rings]",
)
@click.option("--ids", help="Which tags or rings, as 0-5,9. [default: one page from the first]")
@click.option("--count", type=click.IntRange(1, 10_000), help="How many dots. [default: one page]")
@click.option("--family", default="apriltag-36h11", show_default=True, help="Of tags, as in the rig's [control].")
@click.option("--bits", type=click.Choice(["12", "14"]), default="12", show_default=True, help="Segments of a ring.")
@click.option(
    "--label-mm",
    type=click.FloatRange(min=1, max=400),
    help="Side of the white label; a dot's must exceed its diameter and twice its motion. "
    "[default: 5 dots, 1.5 tags, 3.8 ring dots]",
)
@click.option("--paper", type=click.Choice(list(sheets.FORMATS_MM)), default="a4", show_default=True)
@click.option("--landscape", is_flag=True, help="Turn the paper.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), default=Path("targets.pdf"), show_default=True)
def targets(
    kind: str,
    size_mm: float | None,
    ids: str | None,
    count: int | None,
    family: str,
    bits: str,
    label_mm: float | None,
    paper: str,
    landscape: bool,
    out: Path,
) -> None:
    """Write a PDF of targets to print at true scale: dots for the structure, tags or rings for control."""
    if kind == "dots" and ids is not None:
        raise UsageError("dots carry no numbers: give --count")
    if kind != "dots" and count is not None:
        raise UsageError(f"--count is for dots: give --ids for {kind}")
    size = size_mm if size_mm is not None else {"dots": 8.0, "tags": 36.0, "rings": 10.0}[kind]
    label = label_mm if label_mm is not None else size * {"dots": 5.0, "tags": 1.5, "rings": 3.8}[kind]
    least = size * {"dots": 1.5, "tags": 1.25, "rings": 3.2}[kind]
    if label < least:
        raise UsageError(f"--label-mm {label:g} leaves no white around {kind} of {size:g} mm: give {least:g} or more")
    across, up = sheets.grid(label, paper=paper, landscape=landscape)
    if kind == "dots":
        chosen = [sheets.dot(size)] * (count or across * up)
    elif kind == "tags":
        numbers = read_ids(ids) if ids is not None else _first_page(across * up, 0, sheets.tag_count(family))
        chosen = [sheets.tag(family, n, size) for n in numbers]
    else:
        numbers = read_ids(ids) if ids is not None else _first_page(across * up, 1, sheets.ring_count(int(bits)))
        chosen = [sheets.ring(int(bits), n, size) for n in numbers]
    data = sheets.sheets(chosen, label, paper=paper, landscape=landscape)
    _write(out, data)
    pages = -(-len(chosen) // (across * up))
    click.echo(f"{out}: {len(chosen)} {kind} of {size:g} mm on {pages} page{'s' if pages > 1 else ''} of {paper}")
    click.echo("Print at 100 % and measure the bars: 100.0 mm both ways, or use the size you find in rig.toml.")


def _first_page(room: int, first: int, available: int) -> list[int]:
    return list(range(first, first + min(room, available)))


def _write(out: Path, data: bytes) -> None:
    if not out.parent.is_dir():
        raise UsageError(f"{out} cannot be written: there is no such folder")
    try:
        write_durably(out, data)
    except StorageError as exc:
        raise UsageError(str(exc)) from exc
