"""The command line: finds each subcommand when it is called, and turns errors into one line and an exit status."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import cast

import click

from labdaemon import __version__
from labdaemon.errors import LabdaemonError

COMMANDS = {
    "demo": "labdaemon.cli.demo:demo",
    "run": "labdaemon.cli.run:run",
    "submit": "labdaemon.cli.remote:submit",
    "status": "labdaemon.cli.remote:status",
    "watch": "labdaemon.cli.remote:watch",
    "pause": "labdaemon.cli.remote:pause",
    "resume": "labdaemon.cli.remote:resume",
    "abort": "labdaemon.cli.remote:abort",
    "capture": "labdaemon.cli.remote:capture",
    "stop": "labdaemon.cli.remote:stop",
    "safe-stop": "labdaemon.cli.run:safe_stop",
    "plan": "labdaemon.cli.plan:plan",
    "measure": "labdaemon.cli.measure:measure",
    "process": "labdaemon.cli.process:process",
    "calibrate": "labdaemon.cli.calibrate:calibrate",
    "report": "labdaemon.cli.report:report",
    "targets": "labdaemon.cli.targets:targets",
    "bench": "labdaemon.cli.bench:bench",
}
"""Subcommand -> where it lives. Imported only when asked for, so that `--help` and `stop` start at once."""


class LazyGroup(click.Group):
    """A group whose members are imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name].partition(":")
        return cast(click.Command, getattr(import_module(module), attribute))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="labdaemon")
def cli() -> None:
    """Shaker, synchronised cameras, and vibration measured from motion blur."""


def main() -> None:
    """Entry point of the `labdaemon` command.

    Exit status: 0 done, 2 wrong usage or unusable input (one line on stderr), 1 it failed, 130 on Ctrl-C.
    """
    try:
        status = cli.main(standalone_mode=False)
    except click.Abort:
        sys.exit(130)
    except click.exceptions.Exit as exc:
        sys.exit(exc.exit_code)
    except click.ClickException as exc:
        exc.show()
        sys.exit(2)
    except LabdaemonError as exc:
        click.echo(f"labdaemon: {exc}", err=True)
        sys.exit(exc.exit_status)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; say nothing at exit either
        sys.exit(1)
    sys.exit(status if isinstance(status, int) else 0)
