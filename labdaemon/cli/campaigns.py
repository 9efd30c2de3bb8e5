"""`labdaemon rig` and `labdaemon campaigns`: which rig this is, and what was, is and will be done with it."""

from __future__ import annotations

import json
from typing import Any

import click

from labdaemon.cli.remote import address_options, ask, say

WIDTHS = "{:>5}  {:<28} {:<10} {:<20} {}"


@click.command()
@address_options
def rig(address: str, as_json: bool) -> None:
    """Which rig the daemon runs: its file, data folder, devices and limits."""
    answer = ask(address, "rig")
    say(answer, as_json, "\n".join(_rig_lines(answer)))


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def campaigns() -> None:
    """List campaigns, show one, find its results, and change the order of the queue."""


@campaigns.command("list")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True, help="Newest ones to show.")
@address_options
def list_campaigns(limit: int, address: str, as_json: bool) -> None:
    """Campaigns, the newest first; those that wait or run are always among them."""
    answer = ask(address, "campaign.list", limit=limit)
    rows = [WIDTHS.format("queue", "campaign", "state", "submitted", "reason")]
    for one in answer["campaigns"]:
        place = "" if one["place"] is None else str(one["place"])
        rows.append(
            WIDTHS.format(place, one["id"], one["state"], one["submitted_at"][:19], one["reason"] or "").rstrip()
        )
    say(answer, as_json, "\n".join(rows) if answer["campaigns"] else "no campaign yet")


@campaigns.command()
@click.argument("campaign", required=False)
@click.option("--results", is_flag=True, help="Print nothing but the folder of its results.")
@address_options
def show(campaign: str | None, results: bool, address: str, as_json: bool) -> None:
    """One campaign in full; the current one if none is named."""
    answer = ask(address, "campaign.show", campaign=campaign)
    if results:
        click.echo(json.dumps({"results": answer["results"]}) if as_json else answer["results"])
        return
    say(answer, as_json, "\n".join(_campaign_lines(answer)))


@campaigns.command()
@click.argument("campaign")
@click.option("--place", type=click.IntRange(min=0), default=0, show_default=True, help="Its place; 0 is the next.")
@address_options
def move(campaign: str, place: int, address: str, as_json: bool) -> None:
    """Give a campaign that waits another place in the queue."""
    answer = ask(address, "campaign.move", campaign=campaign, place=place)
    say(answer, as_json, "queue: " + ", ".join(answer["queue"]))


def _rig_lines(answer: dict[str, Any]) -> list[str]:
    service = answer["service"]
    lines = [
        f"rig        {answer['config']} (labdaemon {answer['version']}, process {answer['pid']})",
        f"commands   {service['commands']}",
        f"events     {service['events']}",
        f"data       {service['data']}",
    ]
    lines += [f"device     {name}: {identity}" for name, identity in answer["devices"].items()]
    lines += [f"limits     {name} {value}" for name, value in (answer["limits"] or {}).items() if value is not None]
    return lines


def _campaign_lines(answer: dict[str, Any]) -> list[str]:
    about = f"{answer['state']}, {answer['captures']} captures"
    lines = [
        f"campaign   {answer['id']} ({about})",
        f"submitted  {answer['submitted_at']}",
        f"folder     {answer['folder']}",
        f"results    {answer['results']}",
    ]
    lines += [f"reason     {answer['reason']}"] if answer["reason"] else []
    lines += [f"queue      place {answer['place']}"] if answer["place"] is not None else []
    return lines + [
        f"step {step['step']:>4}  {step['state']}, {step['attempts']} attempts {step['reason'] or ''}".rstrip()
        for step in answer["steps"]
    ]
