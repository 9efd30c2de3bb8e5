"""`labdaemon bench`: how accurate and fast the measurement is, and how the daemon bears faults, without hardware."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import cast

import click

from labdaemon.errors import UsageError

ELSEWHERE = {
    name: f"labdaemon.bench.{name}:command"
    for name in (
        "soak",
        "kill",
        "faults",
        "interlock",
        "findings",
        "search",
        "textures",
        "harmonics",
        "planned",
        "page",
        "real",
        "windows",
        "groups",
    )
} | {name: f"labdaemon.bench.{name}.command:command" for name in ("world", "stream")}
"""Subcommands defined in the benches' own modules; imported only when called."""


class _BenchGroup(click.Group):
    """Its own commands, and those of `ELSEWHERE`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*super().list_commands(ctx), *ELSEWHERE]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in ELSEWHERE:
            module, _, attribute = ELSEWHERE[cmd_name].partition(":")
            return cast(click.Command, getattr(import_module(module), attribute))
        return super().get_command(ctx, cmd_name)


@click.group(cls=_BenchGroup)
def bench() -> None:
    """Measure the measurement, on frames rendered by the simulator."""


@bench.command()
@click.option("--seed", "seeds", type=int, multiple=True, default=(1,), show_default=True, help="May be given again.")
@click.option("--quick", is_flag=True, help="One frame a case, fewer cases.")
@click.option("--only", multiple=True, metavar="CASE", help="Run this case only; may be given again.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Where accuracy.png goes; here by default."
)
@click.option("--keep", type=click.Path(file_okay=False, path_type=Path), help="Leave the rendered folders here.")
@click.option("--workers", type=click.IntRange(0), default=0, help="Processes; 0 for one a core.")
@click.option(
    "--section",
    type=click.Choice(["all", "amplitude", "light"]),
    default="all",
    show_default=True,
    help="Amplitudes, or signed motions under coded light and through windows; with --quick all means amplitudes.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def accuracy(
    seeds: tuple[int, ...],
    quick: bool,
    only: tuple[str, ...],
    out: Path | None,
    keep: Path | None,
    workers: int,
    section: str,
    as_json: bool,
) -> None:
    """The published method and ours on the same rendered frames, compared with the Cramér–Rao bound."""
    if section == "light":
        _print_signed(tuple(seeds), quick, workers, as_json, only)
        return
    from labdaemon.bench.accuracy import run_accuracy
    from labdaemon.bench.accuracy_text import document, lines
    from labdaemon.bench.cases import cases
    from labdaemon.bench.chart import draw, figure_class

    drawn = True
    try:
        figure_class()
    except UsageError as exc:
        if out is not None:
            raise
        click.echo(f"no figure: {exc}", err=True)
        drawn = False
    unknown = set(only) - {case.key for case in cases(quick)}
    if unknown:
        known = ", ".join(case.key for case in cases(quick))
        raise click.UsageError(f"no case {', '.join(sorted(unknown))}; there are: {known}")
    result = run_accuracy(
        tuple(seeds),
        quick=quick,
        only=frozenset(only) or None,
        keep=keep,
        workers=workers,
        report=lambda text: click.echo(text, err=True),
    )
    if as_json:
        click.echo(json.dumps(document(result)))
    else:
        for line in lines(result):
            click.echo(line)
        if section == "all" and not quick and not only:
            _print_signed(tuple(seeds), quick, workers, as_json)
    if drawn and any(case.case.pooled for case in result.cases):
        file = (out or Path()) / "accuracy.png"
        draw(result, file)
        click.echo(f"figure: {file}", err=True)


def _print_signed(seeds: tuple[int, ...], quick: bool, workers: int, as_json: bool, only: tuple[str, ...] = ()) -> None:
    """Run the signed motions and print them."""
    from labdaemon.bench.signed import run_signed
    from labdaemon.bench.signed_cases import signed_cases
    from labdaemon.bench.signed_text import signed_document, signed_lines

    unknown = set(only) - {case.key for case in signed_cases(quick)}
    if unknown:
        known = ", ".join(case.key for case in signed_cases(quick))
        raise click.UsageError(f"no case {', '.join(sorted(unknown))}; there are: {known}")
    chosen = frozenset(only) or None
    results = run_signed(
        seeds, quick=quick, only=chosen, workers=workers, report=lambda text: click.echo(text, err=True)
    )
    if as_json:
        click.echo(json.dumps(signed_document(results)))
        return
    for line in signed_lines(results):
        click.echo(line)


@bench.command()
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--repeat", type=click.IntRange(1), default=5, show_default=True, help="The fastest of so many counts.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def speed(seed: int, repeat: int, as_json: bool) -> None:
    """60 targets of 31 px in one 10-megapixel frame, on one core."""
    from labdaemon.bench.speed import document, lines, run_speed

    result = run_speed(seed, repeat)
    if as_json:
        click.echo(json.dumps(document(result)))
        return
    for line in lines(result):
        click.echo(line)
