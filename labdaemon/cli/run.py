"""`labdaemon run`, the service in the foreground, and `labdaemon safe-stop`, for when it has died."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.command()
@click.argument("config", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--data", type=click.Path(file_okay=False, path_type=Path), help="Folder for everything it writes.", metavar="DIR"
)
@click.option("--new-journal", is_flag=True, help="Set a damaged journal aside and begin another.")
@click.option("--accept-changed-rig", is_flag=True, help="Go on with campaigns planned for another rig file.")
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as JSON once it serves.")
def run(config: Path, data: Path | None, new_journal: bool, accept_changed_rig: bool, as_json: bool) -> None:
    """Run the daemon for the rig of CONFIG until Ctrl-C or SIGTERM."""
    from labdaemon.service.config import load_rig
    from labdaemon.service.daemon import Options, run_daemon
    from labdaemon.service.logs import set_up_logs

    def ready(commands: str, events: str) -> None:
        line = json.dumps({"commands": commands, "events": events})
        click.echo(line if as_json else f"commands on {commands}, events on {events}; Ctrl-C ends it")
        sys.stdout.flush()

    rig = load_rig(config)
    set_up_logs()
    sys.exit(run_daemon(rig, Options(data, new_journal, accept_changed_rig), ready=ready))


@click.command("safe-stop")
@click.argument("config", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def safe_stop(config: Path, as_json: bool) -> None:
    """Bring the table of CONFIG to rest, whatever has become of the daemon: opens shaker and trigger, nothing else."""
    from labdaemon.service.config import load_rig
    from labdaemon.service.safe_stop import stop_table

    told = stop_table(load_rig(config, check_drivers=False, check_files=False))
    click.echo(json.dumps({"result": told}) if as_json else told)
