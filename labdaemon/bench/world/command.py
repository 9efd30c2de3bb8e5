"""`labdaemon bench world` as a command."""

from __future__ import annotations

import json
import logging

import click

from labdaemon.bench.world.row import WorldOptions, WorldRow, table_of
from labdaemon.bench.world.sections import SECTIONS, section


@click.command("world")
@click.option("--section", "names", multiple=True, type=click.Choice(list(SECTIONS)), help="Only these.")
@click.option("--quick", is_flag=True, help="A few tries of each kind.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option(
    "--soak-minutes", type=click.FloatRange(0.1), help="Length of the soak for false trips; 30, or 1 with --quick."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(names: tuple[str, ...], quick: bool, seed: int, soak_minutes: float | None, as_json: bool) -> None:
    """Let the daemon meet what devices, disks, sockets and people do to it; one table."""
    logging.getLogger("labdaemon").addHandler(logging.NullHandler())  # faults are the subject; rows report them
    options = WorldOptions(quick, seed, soak_minutes or (1.0 if quick else 30.0))
    rows: list[WorldRow] = []
    for name in names or SECTIONS:
        for row in section(name)(options):
            rows.append(row)
            click.echo(f"{row.section}: {row.what}: {row.result} (goal {row.goal})", err=True)
    click.echo(json.dumps([row.as_json() for row in rows]) if as_json else table_of(rows))
    if not all(row.holds for row in rows):
        raise SystemExit(1)
