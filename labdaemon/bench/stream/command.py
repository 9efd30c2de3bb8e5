"""`labdaemon bench stream` as a command."""

from __future__ import annotations

import json
import logging

import click

from labdaemon.bench.stream.options import SECTIONS, StreamOptions, section
from labdaemon.bench.world.row import WorldRow, table_of


@click.command("stream")
@click.option("--section", "names", multiple=True, type=click.Choice(list(SECTIONS)), help="Only these.")
@click.option("--events", type=click.IntRange(10), default=200, show_default=True, help="Envelopes of 360 targets.")
@click.option("--subscribers", type=click.IntRange(1), default=20, show_default=True)
@click.option("--captures", type=click.IntRange(5), default=30, show_default=True, help="By each way in.")
@click.option("--messages", type=click.IntRange(100), default=20_000, show_default=True, help="Hostile ones.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(
    names: tuple[str, ...],
    events: int,
    subscribers: int,
    captures: int,
    messages: int,
    seed: int,
    as_json: bool,
) -> None:
    """Events out and commands in: against bare ZeroMQ, with stalled subscribers and hostile clients; one table.

    Envelopes come from memory: writing the journal to the disk is not part of the throughput.
    """
    logging.getLogger("labdaemon").addHandler(logging.NullHandler())  # refusals are the subject; rows report them
    options = StreamOptions(events, subscribers, captures, messages, seed)
    rows: list[WorldRow] = []
    for name in names or SECTIONS:
        for row in section(name)(options):
            rows.append(row)
            click.echo(f"{row.section}: {row.what}: {row.result} (goal {row.goal})", err=True)
    click.echo(json.dumps([row.as_json() for row in rows]) if as_json else table_of(rows))
    if not all(row.holds for row in rows):
        raise SystemExit(1)
