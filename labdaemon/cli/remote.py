"""Subcommands that talk to a running daemon. Each prints one line for people, or its JSON for programs."""

from __future__ import annotations

import json
import socket
import sys
import time
from collections.abc import Callable, Generator
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import click
from click.core import ParameterSource

from labdaemon.errors import UsageError
from labdaemon.stream.client import COMMANDS, Client, EventStream, HistoryCut, JournalChanged, NoDaemon
from labdaemon.stream.client_sockets import events_at
from labdaemon.stream.messages import ForbiddenError

KEY = "labdaemon.key"
Command = TypeVar("Command", bound=Callable[..., Any])
STOP_TIMEOUT_S = 15.0  # the daemon gives a stop five seconds to be confirmed, and reports what it saw
CAPTURE_TIMEOUT_S = 120.0  # bulb exposures and slow bodies; an outside system's release is waited for too
SUBMIT_TIMEOUT_S = 60.0  # a first campaign proves the enable line before it is answered
REPLAY_TIMEOUT_S = 2.0
"""Longest that `watch` waits for events that it missed before it looks whether the daemon lives; it asks again."""
ENDED = {"campaign.completed": 0, "campaign.aborted": 1, "campaign.failed": 1}
"""How a campaign ends, and the exit status of who watched it."""


def address_options(command: Command) -> Command:
    """`--address`, `--key` and `--json`, which all of these take."""
    command = click.option(
        "--key",
        envvar="LABDAEMON_KEY",
        type=click.Path(dir_okay=False, path_type=Path),
        metavar="FILE",
        show_envvar=True,
        callback=_remember_key,
        expose_value=False,
        help="The client's key, where the daemon asks for one (labdaemon keys).",
    )(command)
    command = click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON.")(command)
    return click.option(
        "--address",
        default=COMMANDS,
        envvar="LABDAEMON_ADDRESS",
        show_default=True,
        show_envvar=True,
        metavar="TCP",
        callback=_warn_of_two,
        help="The daemon's commands address.",
    )(command)


def _remember_key(context: click.Context, parameter: click.Parameter, key: Path | None) -> None:
    context.meta[KEY] = key


def _warn_of_two(context: click.Context, parameter: click.Parameter, address: str) -> str:
    """Say which daemon is meant where no address was given and several live here."""
    from labdaemon.service.presence import present_daemons

    if parameter.name is None or context.get_parameter_source(parameter.name) is not ParameterSource.DEFAULT:
        return address
    present = present_daemons()
    if len(present) > 1 or any(daemon.commands != address for daemon in present):
        known = "; ".join(f"{daemon.commands} ({daemon.config}, process {daemon.pid})" for daemon in present)
        count = f"{len(present)} daemons run" if len(present) > 1 else "a daemon runs"
        click.echo(
            f"labdaemon: {count} on this computer: {known}; this goes to {address}. Choose with --address or "
            "LABDAEMON_ADDRESS",
            err=True,
        )
    return address


def key_file() -> Path | None:
    """The `--key` of the command that runs."""
    context = click.get_current_context(silent=True)
    return context.meta.get(KEY) if context is not None else None


def ask(address: str, method: str, *, timeout_s: float = 10.0, **params: Any) -> Any:
    """One command to the daemon at `address`."""
    _check_listening(address)
    key = key_file()
    with Client(address, timeout_s=timeout_s, key=key) as client:
        try:
            return client.call(method, **params)
        except NoDaemon as exc:
            if key is not None:
                raise NoDaemon(f"{exc} Is the key of {key} listed there?") from None
            raise NoDaemon(f"{exc} Where it asks for keys, --key is needed.") from None


def _check_listening(address: str) -> None:
    """Fail at once where no daemon listens, instead of after the time a command may take."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    is_tcp = address.startswith("tcp://") and port.isdigit() and int(port) < 1 << 16
    if not is_tcp and not address.startswith("ipc:///"):
        raise UsageError(f"--address {address}: write tcp://127.0.0.1:PORT or ipc:///PATH")
    try:
        if is_tcp:
            socket.create_connection((host.strip("[]"), int(port)), timeout=3.0).close()
        else:
            with socket.socket(socket.AF_UNIX) as probe:
                probe.connect(address.removeprefix("ipc://"))
    except PermissionError:
        raise ForbiddenError(f"{address} is for other users of this machine (see its owner and group)") from None
    except OSError as exc:
        raise NoDaemon(
            f"no daemon listens at {address} ({exc.strerror or exc}): is `labdaemon run` running there?"
        ) from None


def say(result: Any, as_json: bool, sentence: str) -> None:
    """Print an answer the way it was asked for."""
    click.echo(json.dumps(result) if as_json else sentence)


@click.command()
@click.argument("campaign", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--request-id", help="Submit at most once under this name, however often it is sent.")
@address_options
def submit(campaign: Path, request_id: str | None, address: str, as_json: bool) -> None:
    """Give a campaign file to the daemon; it is checked against the rig first."""
    from labdaemon.campaign.campaign_file import load_campaign

    text = load_campaign(campaign).toml
    result = ask(
        address, "campaign.submit", timeout_s=SUBMIT_TIMEOUT_S, toml=text, request_id=request_id or uuid4().hex
    )
    for note in result.get("notes", ()):
        click.echo(f"note: {note}", err=True)
    say(result, as_json, f"campaign {result['campaign']} submitted")


@click.command()
@address_options
def status(address: str, as_json: bool) -> None:
    """Show what the daemon does now."""
    from labdaemon.cli.progress import status_lines

    result = ask(address, "status")
    say(result, as_json, "\n".join(status_lines(result)))


def _campaign_command(name: str, done: str, text: str) -> click.Command:
    """`pause`, `resume` and `abort` differ in a word."""

    @click.command(name=name, help=text)
    @click.argument("campaign", required=False)
    @address_options
    def command(campaign: str | None, address: str, as_json: bool) -> None:
        params = {} if campaign is None else {"campaign": campaign}
        result = ask(address, f"campaign.{name}", timeout_s=STOP_TIMEOUT_S, **params)
        chosen = (result or {}).get("campaign") if isinstance(result, dict) else None
        say(result, as_json, f"campaign {chosen or campaign or ''}".rstrip() + f" {done}")

    return command


pause: click.Command = _campaign_command("pause", "paused", "Hold the campaign; the table comes to rest.")
resume: click.Command = _campaign_command("resume", "resumed", "Go on with a campaign that was paused.")
abort: click.Command = _campaign_command("abort", "aborted", "End the campaign; the table comes to rest.")


@click.command()
@click.option(
    "--label", default="manual", show_default=True, help="Part of the capture's name, and in its capture.toml."
)
@click.option("--sharp", is_flag=True, help="A sharp set: the structure is at rest.")
@click.option("--frequency-hz", type=float, metavar="HZ", help="Of the excitation, as the shaker's software knows it.")
@click.option("--excitation-amplitude-mm", type=float, metavar="MM", help="Of the table, zero to peak.")
@click.option("--phase-rad", type=float, metavar="RAD", help="Excitation phase at the opening.")
@click.option("--group", help="Captures of one group are measured jointly, and reported once under this name.")
@click.option("--exposure-s", type=float, metavar="S", help="Of the shutters; the rig file's if not given.")
@click.option("--request-id", help="Fire at most once under this name, however often it is sent.")
@address_options
def capture(label: str, sharp: bool, request_id: str | None, address: str, as_json: bool, **stated: Any) -> None:
    """Fire all shutters once, now; where an outside system fires, its next release is this capture.

    Frequency and amplitude that are not stated are taken from the table gauge.
    """
    wish = {"label": label, "request_id": request_id or uuid4().hex, **({"sharp": True} if sharp else {})}
    wish |= {name: value for name, value in stated.items() if value is not None}
    result = ask(address, "capture", timeout_s=CAPTURE_TIMEOUT_S, **wish)
    name, opened_at = result["capture"], result["opened_at"]
    say(result, as_json, f"capture {name} " + (f"opened at {opened_at}" if opened_at else "waits for the next release"))


@click.command()
@address_options
def stop(address: str, as_json: bool) -> None:
    """Bring the shaker to rest now, whatever the daemon does at this moment."""
    try:
        result = ask(address, "stop", timeout_s=STOP_TIMEOUT_S)
    except NoDaemon as exc:
        raise NoDaemon(
            f"{exc} If the table moves, use the emergency stop, or `labdaemon safe-stop RIG.toml`: it needs no daemon."
        ) from None
    for trouble in result.get("troubles", ()):
        click.echo(f"labdaemon: {trouble}", err=True)
    say(result, as_json, "there is no shaker" if result.get("rest") == "none" else "the shaker is at rest")


@click.command()
@click.option("--events", "events_address", metavar="TCP", help="The events address; by default the daemon is asked.")
@click.option("--after", type=click.IntRange(min=0), help="Begin after this event of the journal.")
@click.option("--until-end", is_flag=True, help="End when the campaign ends; exit 0 only if it completed.")
@click.option(
    "--patience",
    type=click.FloatRange(min=1.0),
    default=60.0,
    show_default=True,
    metavar="S",
    help="Longest silence of the daemon, for example while it is started again; after that the command fails.",
)
@address_options
def watch(
    events_address: str | None, after: int | None, until_end: bool, patience: float, address: str, as_json: bool
) -> None:
    """Follow the daemon's events: step, capture, time left, largest amplitude, faults."""
    from labdaemon.cli.progress import Progress

    if events_address is None:
        events_address = events_at(ask(address, "rig")["service"]["events"], address)
    with (
        Client(address, events_address, timeout_s=REPLAY_TIMEOUT_S, key=key_file()) as client,
        Progress(plain=as_json, to_stderr=as_json) as progress,
        closing(_follow(client, after, patience)) as events,
    ):
        for event in events:
            if event is None:
                progress.check_silence()
            elif as_json:
                progress.note_heartbeat()
                click.echo(json.dumps(event))
            else:
                progress.show(event)
            if until_end and event is not None and event["kind"] in ENDED:
                sys.exit(ENDED[event["kind"]])


def _follow(client: Client, after: int | None, patience_s: float) -> Generator[dict[str, Any] | None, None, None]:
    """Events in order, through restarts of the daemon and changes of its journal; None each second that none comes."""
    heard_s = time.monotonic()
    with closing(EventStream(client, after=after)) as stream:
        while True:
            try:
                event = stream.receive(1.0)
            except (JournalChanged, HistoryCut) as exc:
                click.echo(f"labdaemon: {exc}", err=True)
                continue
            except NoDaemon:  # it went away between an event and the replay of those before it
                event = None
            if event is not None:
                heard_s = time.monotonic()
                yield event
                continue
            yield None
            if time.monotonic() > heard_s + patience_s:
                raise NoDaemon(f"nothing from {client.events_address} for {patience_s:g} s: has the daemon ended?")
