"""`labdaemon modes`: the resonances and mode shapes that a campaign's envelopes show."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from labdaemon.findings.propagation import Estimate


def _with_sd(one: Estimate) -> str:
    return f"{one.value:.5f} ± {one.sd:.5f}"


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with the shapes.")
def modes(folder: Path, as_json: bool) -> None:
    """Find natural frequencies, damping ratios and mode shapes in the results of the data-set FOLDER.

    The folder needs envelopes at several frequencies around each resonance. A mode without evidence is not reported;
    the notes say why.
    """
    from labdaemon.analysis.campaign_modes import campaign_modes

    found = campaign_modes(folder)
    if as_json:
        click.echo(json.dumps(found.to_json()))
        return
    for one in found.modes:
        mode = one.mode
        nodes = ", ".join(f"{point.height_mm:.1f} ± {point.sd_mm:.1f} mm" for point in one.nodes) or "none"
        click.echo(
            f"{mode.frequency_hz:.4f} ± {mode.sd_frequency_hz:.4f} Hz, damping {100 * mode.damping:.3f} ± "
            f"{100 * mode.sd_damping:.3f} %, nodes at {nodes}, out of plane {100 * one.out_of_plane.value:.1f} %"
            + ("" if one.complex_shape is None else f", phase collinearity {_with_sd(one.collinearity)}")
        )
    if not found.modes:
        click.echo("no mode")
    peak = found.transmissibility.peak()
    if peak is not None:
        target, frequency, value, sd = peak
        click.echo(
            f"{target} moves {value:.4g} ± {sd:.2g} times as far as the table at {frequency:.4f} Hz: the largest"
        )
    if found.next_hz is not None:
        click.echo(f"the next step gives most information at {found.next_hz:.4f} Hz")
    for note in found.notes:
        click.echo(f"note: {note}")
