"""`labdaemon demo`: the main job without hardware, compared with a truth that only the simulator knows."""

from __future__ import annotations

import math
import shutil
import signal
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from labdaemon.errors import LabdaemonError, UsageError
from labdaemon.report.accuracy import FLOOR_MM, CaptureAccuracy, summary

if TYPE_CHECKING:
    from labdaemon.cli.demo_lab import DemoLab

THREE_MODES = """\
# The first three modes of a four-storey frame: at rest, then one second at each resonance.
name = "three-modes"

[[phase]]
kind = "sharp"
frames = 3

[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0, 12.0]
amplitude_mm = [2.0, 1.0, 0.5]        # of the table, zero to peak
captures = 1
exposure_s = 1.0                      # the plan takes the camera's step nearest to whole cycles
settle = { max_change_per_cycle = 0.001, timeout_s = 60 }
on_fault = "retry"
"""
"""As `config/campaigns/three-modes.toml` has it."""


@click.command()
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Where to leave everything; labdaemon-demo if not given.",
)
@click.option(
    "--campaign",
    type=click.Path(dir_okay=False, path_type=Path),
    help="A campaign file; the first three modes of the simulated frame if not given.",
)
@click.option(
    "--serve",
    is_flag=True,
    help="Keep running for clients, campaign after campaign, on fixed ports of loopback; prints how clients connect.",
)
@click.option(
    "--modification",
    type=click.Choice(["none", "mass", "thinned", "thinned-only"]),
    default="none",
    show_default=True,
    help="Of the structure, as in McCarthy 2016: mass on level 4, and members cut between levels 2 and 3.",
)
def demo(out: Path | None, campaign: Path | None, serve: bool, modification: str) -> None:
    """Run a campaign on a simulated rig, and compare the results with what the rig truly did. Needs no hardware.

    Rig and daemon run as processes of their own; the daemon reaches the rig through the devices' real protocols.
    """
    from labdaemon.campaign.campaign_file import load_campaign
    from labdaemon.cli.demo_serve import serve_demo

    if serve and modification != "none":
        raise UsageError("--modification belongs to a demo that ends; --serve has the frame as it is")
    given = load_campaign(campaign).toml if campaign is not None else None
    out = free_folder(out)
    end_on_signals()
    try:
        if serve:
            serve_demo(out, given)
        else:
            _demo(out, given or THREE_MODES, attended=campaign is not None, modification=modification)
    except LabdaemonError as exc:
        if exc.exit_status == UsageError.exit_status:
            shutil.rmtree(out)  # nothing was begun
        else:
            click.echo(f"the daemon's log is {out / 'daemon.log'}", err=True)
        raise


def _demo(out: Path, text: str, *, attended: bool, modification: str = "none") -> None:
    from labdaemon.cli.demo_lab import laboratory
    from labdaemon.cli.demo_modes import mode_lines
    from labdaemon.cli.demo_results import check_same_numbers, draw_overlays, link_folder, truth_of, write_truth
    from labdaemon.report.folder_page import report_folder
    from labdaemon.report.signed_accuracy import compare_signed, signed_lines

    began = time.monotonic()
    click.echo(f"Starting the simulated rig and the daemon in {out} …")
    with laboratory(out, modification=modification) as lab:
        folder, envelopes, coded, searches = _run_campaign(lab, text, attended=attended)
        records, modes = lab.rig.truth(), lab.rig.modes()
    truth = truth_of(envelopes, records)
    rows = check_same_numbers(envelopes, folder / "results")
    link_folder(out, folder)
    write_truth(out / "truth.csv", truth)
    draw_overlays(folder, folder / "results")
    _, accuracies = report_folder(
        folder, title=f"Campaign {folder.name}", subtitle="labdaemon demo on the simulated rig", truth=truth
    )
    click.echo(f"\nEnvelopes as received and as stored agree in all of {rows} targets.")
    signed = [
        compare_signed(one["capture"], one["targets"], truth[one["capture"]])
        for one in envelopes
        if one["capture"] in coded
    ]
    for line in (*accuracy_lines(accuracies), *signed_lines(signed)):
        click.echo(line)
    for end in searches:
        click.echo("")
        for line in mode_lines(end, modes):
            click.echo(line)
    click.echo(f"\nResults  {out / 'results'}\nReport   {out / 'results' / 'index.html'}")
    click.echo(f"Took     {time.monotonic() - began:.0f} s")


def _run_campaign(
    lab: DemoLab, text: str, *, attended: bool
) -> tuple[Path, list[dict[str, Any]], set[str], list[dict[str, Any]]]:
    """Submit it and follow it to its end.

    Returns
    -------
    folder, envelopes, coded, searches
        Its folder, the data of its envelopes, the names of those that were taken under coded light, and what ended
        each search for modes.
    """
    from labdaemon.cli.demo_lab import DemoFailed
    from labdaemon.cli.progress import Progress

    envelopes: list[dict[str, Any]] = []
    coded: set[str] = set()
    searches: list[dict[str, Any]] = []
    submitted = lab.client.call("campaign.submit", toml=text)
    with Progress() as progress:
        for event in lab.events():
            progress.show(event)
            if event["campaign"] != submitted["campaign"]:
                continue
            match event["kind"]:
                case "envelope":
                    envelopes.append(event["data"])
                case "step.decided" if event["data"].get("frequency_hz") is None and event["data"].get("measured"):
                    searches.append(event["data"])
                case "capture.completed" if event["data"].get("light"):
                    coded.add(event["data"].get("group") or event["data"]["capture"])
                case "campaign.completed":
                    break
                case "campaign.paused" if attended:
                    click.echo(f"go on with: labdaemon resume --address {lab.client.commands_address}")
                case "campaign.failed" | "campaign.aborted" | "campaign.paused":
                    raise DemoFailed(f"{event['kind']}: {event['data'].get('reason') or 'the log may tell why'}")
    if not envelopes:
        raise DemoFailed("the campaign completed without a single envelope")
    return Path(submitted["folder"]), envelopes, coded, searches


def end_on_signals() -> None:
    """End rig and daemon in order on every signal that ends a process, once: a second one must not cut that short."""
    from labdaemon.service.signals import ending_signals, exit_status, ignore_suspension

    numbers = ending_signals()

    def end(number: int, _: object) -> NoReturn:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        if number in (signal.SIGINT, signal.SIGTERM):
            raise KeyboardInterrupt
        raise SystemExit(exit_status(number))

    for number in numbers:
        signal.signal(number, end)
    ignore_suspension()


def free_folder(asked: Path | None) -> Path:
    """An empty folder: the one asked for, or ``labdaemon-demo`` with a number if that is taken.

    Raises
    ------
    UsageError
        The one asked for holds something already, or cannot be made.
    """
    if asked is None:
        asked, number = Path("labdaemon-demo"), 1
        while asked.exists():
            number += 1
            asked = Path(f"labdaemon-demo-{number}")
    try:
        if asked.exists() and any(asked.iterdir()):
            raise UsageError(f"{asked} is not empty; give --out a new folder")
        asked.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise UsageError(f"{asked} cannot be used: {exc.strerror}") from None
    return asked.resolve()


def accuracy_lines(accuracies: Iterable[CaptureAccuracy]) -> list[str]:
    """A table of errors in text, pooled in its last line."""
    known = list(accuracies)
    pooled = summary("all", [pair for one in known for pair in one.pairs])
    head = f"{'capture':<24}{'targets':>8}{'unflagged':>10}{'compared':>9}{'mean mm':>10}{'sd mm':>9}{'95 % mm':>9}"
    lines = [
        f"{one.capture:<24}{one.targets:>8}{one.unflagged:>10}{one.compared:>9}"
        f"{_number(one.mean_mm, '+.4f'):>10}{_number(one.sd_mm, '.4f'):>9}{_number(one.p95_mm, '.4f'):>9}"
        for one in [*known, pooled]
    ]
    return [f"Error of semi-amplitudes of {FLOOR_MM:g} mm and more against the simulator's truth:", head, *lines]


def _number(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)
