"""`labdaemon plan`: what a campaign would do, checked against the rig, before anything moves."""

from __future__ import annotations

import json
import math
import os
import shutil
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import click

from labdaemon.campaign.campaign_file import load_campaign
from labdaemon.campaign.limits import ShakerLimits, largest_amplitude_mm, peak_acceleration_mm_s2, peak_velocity_mm_s
from labdaemon.campaign.plan import make_plan
from labdaemon.campaign.steps import Plan, Step
from labdaemon.capture.exposure import part_cycle
from labdaemon.cli.progress import duration
from labdaemon.cli.remote import ask
from labdaemon.errors import UsageError
from labdaemon.service.config import RigConfig, load_rig, plan_rig
from labdaemon.service.enable_line_note import enable_line, sentence
from labdaemon.service.lamp_settings import image_scale
from labdaemon.stream.client import COMMANDS, NoDaemon

Goal = Literal["amplitude", "phase"]
WHOLE_WITHIN_CYCLES = 0.05
"""Further from whole than this a capture without phase is flagged `part_cycles`."""
SIMULATED_RIG = Path("config/sim.toml")


@click.command()
@click.argument("campaign", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--config",
    type=click.Path(dir_okay=False, path_type=Path),
    help=f"The rig file; if not given the running daemon's, or else {SIMULATED_RIG} where that is.",
)
@click.option("--address", default=COMMANDS, envvar="LABDAEMON_ADDRESS", metavar="TCP", help="The daemon to ask.")
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
@click.option("--optimise", is_flag=True, help="Choose exposures, openings and light codes that know most in the time.")
@click.option(
    "--goal", type=click.Choice(["amplitude", "phase"]), help="What is to be known; as the phases say if not given."
)
@click.option(
    "--expected-mm", type=click.FloatRange(1e-3, 1e3), nargs=2, help="Least and largest semi-amplitude expected."
)
@click.option(
    "--transmissibility",
    type=click.FloatRange(1e-3, 1e3),
    nargs=2,
    help="The same over the table's amplitude; 0.5 and 5 if neither is given.",
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write the optimised campaign here.")
@click.option("--write", is_flag=True, help="Replace the campaign file by the optimised one.")
def plan(
    campaign: Path,
    config: Path | None,
    address: str,
    as_json: bool,
    optimise: bool,
    goal: Goal | None,
    expected_mm: tuple[float, float] | None,
    transmissibility: tuple[float, float] | None,
    out: Path | None,
    write: bool,
) -> None:
    """Every step of a campaign with its exposures, time and disk, each checked against the rig's limits.

    Exposure times are the usual thirds of a stop where the rig file does not list a body's own.
    """
    rig = load_rig(config or _known_rig(address))
    room = _free_bytes(rig.data)
    if optimise:
        _optimise(campaign, rig, goal, (expected_mm, transmissibility), campaign if write else out, as_json=as_json)
        return
    if any((goal, expected_mm, transmissibility, out, write)):
        raise UsageError("--goal, --expected-mm, --transmissibility, --out and --write belong to --optimise")
    made = make_plan(load_campaign(campaign), plan_rig(rig, free_bytes=room))
    if as_json:
        click.echo(json.dumps(_document(made) | {"enable_line": enable_line(rig)}))
        return
    for line in table(made, rig.limits):
        click.echo(line)
    for line in light_lines(made):
        click.echo(line)
    if any(_star(shot.cycles) == "*" for step in made.steps for shot in step.shots if shot.light is None):
        click.echo("* a part cycle: measured with the shutter's true window, which takes the excitation's phase")
    note = sentence(enable_line(rig))
    count = sum(not step.is_open or bool(step.shots) for step in made.steps)
    click.echo(
        f"{'at most ' if made.searches else ''}{count} steps, "
        f"{sum(len(step.shots) for step in made.steps)} captures, about "
        f"{duration(made.predicted_s)}, {made.predicted_bytes / 1e9:.2f} GB of {room / 1e9:.0f} GB free"
        + (f"; {note}" if note else "")
    )


def _optimise(
    campaign: Path,
    rig: RigConfig,
    goal: Goal | None,
    expected: tuple[tuple[float, float] | None, tuple[float, float] | None],
    to: Path | None,
    *,
    as_json: bool,
) -> None:
    """Search, and print the designs and the campaign that has them."""
    # Loaded where it is asked for: the modelled images take longer to load than a plan to make.
    from labdaemon.cli import optimise_plan

    if None not in expected:
        raise UsageError("--expected-mm and --transmissibility say the same: give one of them")
    for low, high in (one for one in expected if one is not None):
        if not low <= high:  # NaN among it
            raise UsageError(f"the least value comes first: {low:g} {high:g}")
    read, planned = load_campaign(campaign), plan_rig(rig)
    designs = optimise_plan.search_designs(
        read,
        planned,
        image_scale(rig),
        goal=goal,
        expected_mm=expected[0],
        transmissibility=expected[1],
        progress=lambda text: click.echo(text, err=True),
    )
    text = optimise_plan.campaign_toml(read, designs)
    if as_json:
        click.echo(json.dumps({"designs": optimise_plan.document(designs), "toml": text}))
    else:
        for line in optimise_plan.lines(designs):
            click.echo(line)
        if to is None:
            click.echo("\n" + text, nl=False)
    if to is not None:
        optimise_plan.save(text, to, planned)


def _known_rig(address: str) -> Path:
    """The rig file to plan for when none was named; said, since limits come from it."""
    try:
        path = Path(ask(address, "rig")["config"])
    except NoDaemon:
        path = SIMULATED_RIG
        if not os.path.isfile(path):
            raise UsageError("no daemon runs here to ask for its rig; give --config RIG.toml") from None
    click.echo(f"planned for {path}", err=True)
    return path


def table(made: Plan, limits: ShakerLimits | None) -> list[str]:
    """The steps as lines of text; the last column is the share of the tightest of the table's limits."""
    head = (
        f"{'step':<26}{'f Hz':>8}{'A mm':>8}{'v mm/s':>8}{'a mm/s²':>9}{'shots':>6}{'exposure s':>12}{'cycles':>8} "
        f"{'time':>9}{'limit':>7}"
    )
    lines = [head]
    for is_open, group in groupby(made.steps, key=lambda step: step.is_open):
        steps = list(group)
        lines += [_open_line(steps)] if is_open else [_line(step, limits) for step in steps]
    return lines


def _open_line(steps: list[Step]) -> str:
    """What a search for modes may add."""
    shots = sum(len(step.shots) for step in steps)
    count = sum(bool(step.shots) for step in steps)
    time = duration(sum(step.predicted_s for step in steps))
    return f"{steps[0].label:<26}up to {count} steps more, decided from the envelopes before: {shots} captures, {time}"


def _line(step: Step, limits: ShakerLimits | None) -> str:
    frequency, amplitude = step.frequency_hz, step.amplitude_mm
    motion = ["", "", "", ""]
    share = ""
    if frequency is not None:
        motion[0] = f"{frequency:.3f}"
    if frequency is not None and amplitude is not None:
        velocity, acceleration = peak_velocity_mm_s(frequency, amplitude), peak_acceleration_mm_s2(frequency, amplitude)
        motion[1:] = [f"{amplitude:.3g}", f"{velocity:.4g}", f"{acceleration:.4g}"]
        if limits is not None:
            share = f"{amplitude / largest_amplitude_mm(limits, frequency):.0%}"
    shot = step.shots[0] if step.shots else None
    exposure = f"{shot.exposure_s:.4g}" if shot else ""
    cycles = ""
    if shot and shot.cycles is not None:
        cycles = f"{shot.cycles:.2f}{' ' if shot.light is not None else _star(shot.cycles)}"
    return (
        f"{step.label:<26}{motion[0]:>8}{motion[1]:>8}{motion[2]:>8}{motion[3]:>9}{len(step.shots) or '':>6}"
        f"{exposure:>12}{cycles:>9}{duration(step.predicted_s):>9}{share:>7}"
    ).rstrip()


def light_lines(made: Plan) -> list[str]:
    """What each step under coded light is predicted to know, and what a person should know before it runs."""
    head = (
        f"{'coded light':<26}{'cycles':>8}{'expected':>16}{'sd mm':>9}{'sd phase':>9}{'worst':>8}{'nearest twin':>14}"
    )
    lines: list[str] = []
    for step in made.steps:
        known = step.precision
        light = step.shots[0].light if step.shots else None
        if known is None or light is None:
            continue
        expected = f"{known.amplitude_mm:.2g} mm {known.amplitude_px:.2g} px"
        lines.append(
            f"{step.label:<26}{light.cycles:>8}{expected:>16}{known.sd_amplitude_mm:>9.4f}"
            f"{math.degrees(known.sd_phase_rad):>8.2f}°{math.degrees(known.worst_sd_phase_rad):>7.2f}°"
            f"{known.twin_sd:>11.3g} sd"
        )
    notes = [f"note: {note}" for note in made.notes]
    if not lines:
        return notes
    about = "of one target and camera, Cramér–Rao; expected is the table's amplitude unless the phase says expected_mm"
    return [head, *lines, f"({about})", *notes]


def _star(cycles: float | None) -> str:
    return "*" if cycles is not None and part_cycle(cycles) > WHOLE_WITHIN_CYCLES else " "


def _document(made: Plan) -> dict[str, Any]:
    steps = [asdict(step) for step in made.steps]
    totals = {"predicted_s": made.predicted_s, "predicted_bytes": made.predicted_bytes}
    return {"name": made.name, "digest": made.digest, **totals, "steps": steps, "notes": list(made.notes)}


def _free_bytes(folder: Path) -> int:
    """Room on the disk that the daemon would write to."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free
