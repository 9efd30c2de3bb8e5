"""`labdaemon compare`: what changed between two campaigns, and where."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import click

from labdaemon.errors import UsageError

SHOWN_Z = 3.0
"""Nodes that moved by fewer sd are in the JSON alone."""


@click.command()
@click.argument("baseline", type=click.Path(file_okay=False, path_type=Path))
@click.argument("other", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--levels-mm",
    metavar="Z,Z,…",
    help="Heights of the floors above the table, from the lowest up; the targets' heights if not given.",
)
@click.option(
    "--same-scale",
    is_flag=True,
    help="You vouch that temperature and table amplitude stayed: a change that is the same everywhere counts, too.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def compare(baseline: Path, other: Path, levels_mm: str | None, same_scale: bool, as_json: bool) -> None:
    """Compare the envelopes of the data-set folder OTHER with those of BASELINE.

    A change that is the same everywhere (temperature, mass everywhere, table amplitude, moved cameras) is reported as
    that. What remains is tested at a false-alarm rate of 5 % over all targets, modes and storeys together.
    """
    from labdaemon.analysis.campaign_comparison import compare_campaigns

    found = compare_campaigns(baseline, other, level_mm=_levels(levels_mm), same_scale=same_scale)
    if as_json:
        click.echo(json.dumps(found.to_json()))
        return
    result = found.comparison
    verdict = "changed" if result.changed else "no change beyond noise and what is the same everywhere"
    click.echo(f"{verdict} (p = {result.p_value:.2g})")
    for one in result.modes:
        click.echo(
            f"  mode {one.frequency_hz:.4f} Hz -> {one.other_hz:.4f} Hz: {100 * one.shift:+.4f} ± "
            f"{100 * one.sd_shift:.4f} % (z {one.z_shift:+.1f}), damping {100 * one.damping_change:+.1f} ± "
            f"{100 * one.sd_damping_change:.1f} % (z {one.z_damping_change:+.1f}), MAC {one.mac.value:.6f} ± "
            f"{one.mac.sd:.6f} (z {one.mac.z:+.1f})"
        )
        for node in one.node_shifts:
            if abs(node.z) > SHOWN_Z:
                where = f"member {node.member + 1} at {node.height_mm:.0f} mm"
                click.echo(f"    node of {where} moved by {node.shift_mm:+.1f} ± {node.sd_mm:.1f} mm (z {node.z:+.1f})")
    if result.comac:
        target, lowest = min(result.comac.items(), key=lambda pair: pair[1].z)
        click.echo(f"  lowest COMAC: {lowest.value:.5f} ± {lowest.sd:.5f} at {target} (z {lowest.z:+.1f})")
    for finding in result.findings[:20]:
        click.echo(f"  {finding.text}")
    for change in result.explained_by:
        click.echo(f"  explained: {change.text}")
    for note in result.notes:
        click.echo(f"  note: {note}")


def _levels(text: str | None) -> tuple[float, ...] | None:
    """Heights of `190,380,570`.

    Raises
    ------
    UsageError
        They are no ascending positive numbers.
    """
    if text is None:
        return None
    try:
        heights = tuple(float(part) for part in text.split(","))
    except ValueError:
        heights = ()
    if len(heights) < 2 or any(not 0 < low < high < 1e6 for low, high in pairwise(heights)):
        raise UsageError(f"--levels-mm {text!r} is not two or more ascending heights, as 190,380,570,760")
    return heights
