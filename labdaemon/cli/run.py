"""`labdaemon run`, the service in the foreground, and `labdaemon safe-stop`, for when it has died."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labdaemon.errors import InterlockError, LabdaemonError

if TYPE_CHECKING:
    from labdaemon.service.safe_stop import TableClaim


@click.command()
@click.argument("config", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--data", type=click.Path(file_okay=False, path_type=Path), help="Folder for everything it writes.", metavar="DIR"
)
@click.option("--new-journal", is_flag=True, help="Set a damaged journal aside and begin another.")
@click.option("--accept-changed-rig", is_flag=True, help="Continue campaigns that were planned with another rig file.")
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as JSON once it serves.")
def run(config: Path, data: Path | None, new_journal: bool, accept_changed_rig: bool, as_json: bool) -> None:
    """Run the daemon for the rig of CONFIG until Ctrl-C or SIGTERM."""
    from labdaemon.service.logs import set_up_logs
    from labdaemon.service.safe_stop import claim_table
    from labdaemon.service.signals import exit_status

    set_up_logs()
    # First of all the table: nothing that may be refused below can keep it moving.
    held = claim_table(config)
    try:
        if held.signal is not None:
            sys.exit(1 if held.unconfirmed is not None else exit_status(held.signal))
        sys.exit(_run(config, data, new_journal, accept_changed_rig, as_json, held))
    except LabdaemonError as exc:
        raise _unrested(exc, held) from exc
    finally:
        if held.lock is not None:
            held.lock.release()


def _run(
    config: Path, data: Path | None, new_journal: bool, accept_changed_rig: bool, as_json: bool, held: TableClaim
) -> int:
    from labdaemon.service.config import load_rig
    from labdaemon.service.daemon import DaemonOptions, run_daemon

    def ready(commands: str, events: str) -> None:
        line = json.dumps({"commands": commands, "events": events})
        click.echo(line if as_json else f"commands on {commands}, events on {events}; Ctrl-C ends it")
        sys.stdout.flush()

    rig = load_rig(config)
    return run_daemon(rig, DaemonOptions(data, new_journal, accept_changed_rig), ready=ready, lock=held.lock)


def _unrested(exc: LabdaemonError, held: TableClaim) -> LabdaemonError:
    """The error that ends the process: whoever started it learns of a table that was not seen to rest, first of all."""
    if held.unconfirmed is None or isinstance(exc, InterlockError):
        return exc
    return InterlockError(f"{held.unconfirmed}. Moreover: {exc}")


@click.command("safe-stop")
@click.argument("config", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def safe_stop(config: Path, as_json: bool) -> None:
    """Bring the table of CONFIG to rest: through its daemon, or where none runs through shaker and trigger directly."""
    from labdaemon.service.safe_stop import stop_table

    said = stop_table(config)
    click.echo(json.dumps({"result": said, "table": "rest"}) if as_json else said)
