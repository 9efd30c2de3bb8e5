"""The command line: finds each subcommand when it is called, and turns errors into one line and an exit status."""

from __future__ import annotations

import os
import select
import sys
from difflib import get_close_matches
from importlib import import_module
from typing import cast

import click

from labdaemon.cli.error_json import print_error
from labdaemon.errors import LabdaemonError
from labdaemon.version import __version__

COMMANDS = {
    "demo": ("labdaemon.cli.demo:demo", "Run a campaign on a simulated rig and compare it with the truth."),
    "run": ("labdaemon.cli.run:run", "Run the daemon for a rig until Ctrl-C or SIGTERM."),
    "submit": ("labdaemon.cli.remote:submit", "Give a campaign to the daemon."),
    "status": ("labdaemon.cli.remote:status", "Show what the daemon does now."),
    "watch": ("labdaemon.cli.remote:watch", "Follow the daemon's events."),
    "pause": ("labdaemon.cli.remote:pause", "Pause the campaign; the table comes to rest."),
    "resume": ("labdaemon.cli.remote:resume", "Continue a campaign that was paused."),
    "abort": ("labdaemon.cli.remote:abort", "End the campaign; the table comes to rest."),
    "capture": ("labdaemon.cli.remote:capture", "Fire all shutters once, now."),
    "stop": ("labdaemon.cli.remote:stop", "Bring the shaker to rest now."),
    "rig": ("labdaemon.cli.campaigns:rig", "Show which rig the daemon runs."),
    "campaigns": ("labdaemon.cli.campaigns:campaigns", "Campaigns: list, show, results folder, order of the queue."),
    "safe-stop": ("labdaemon.cli.run:safe_stop", "Bring the table to rest when the daemon has died."),
    "plan": ("labdaemon.cli.plan:plan", "Every step of a campaign, checked against a rig."),
    "measure": ("labdaemon.cli.measure:measure", "Motion in pixels from a sharp and blurred frames."),
    "process": ("labdaemon.cli.process:process", "Envelopes in millimetres from a data-set folder."),
    "report": ("labdaemon.cli.report:report", "A page about a data-set folder's results."),
    "modes": ("labdaemon.cli.modes:modes", "Resonances and mode shapes in a campaign's envelopes."),
    "compare": ("labdaemon.cli.compare:compare", "What changed between two campaigns, and where."),
    "export": ("labdaemon.cli.export:export", "Results as HDF5, Parquet, UFF, VTK, MATLAB or netCDF."),
    "verify": ("labdaemon.cli.verify:verify", "Recompute hashes, and measure the frames of a folder again."),
    "noise-floor": ("labdaemon.cli.verify:noise_floor_command", "Measure what the set-up reads at rest."),
    "calibrate": ("labdaemon.cli.calibrate:calibrate", "Calibrate a camera, the shaker or a shutter."),
    "targets": ("labdaemon.cli.targets:targets", "Targets to print."),
    "bridge": ("labdaemon.cli.bridge:bridge", "Pass a daemon's events on to MQTT or bluesky."),
    "keys": ("labdaemon.cli.keys:keys", "Make, list and revoke the keys of clients on the network."),
    "api": ("labdaemon.cli.api:api", "Describe events and commands: OpenRPC, AsyncAPI, JSON Schema."),
    "bench": ("labdaemon.cli.bench:bench", "Measure labdaemon itself."),
}
"""Subcommand -> its function, and its line in `--help`. Imported only when called, so that `stop` starts at once."""

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that libraries of linear algebra read when numpy is imported. The matrices here are small: a second thread
takes ten times the processor's time where others need it, as while a daemon measures."""
STDERR_MS = 1000
"""How long the last line waits for a reader of stderr."""


class LazyGroup(click.Group):
    """A group whose members are imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        return cast(click.Command, getattr(import_module(module), attribute))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that was typed; one that is not there is refused with the one that was probably meant."""
        near = get_close_matches(args[0], COMMANDS, 1) if args and args[0] not in COMMANDS else []
        if near:
            ctx.fail(f"no command {args[0]!r}; did you mean {near[0]}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="labdaemon")
def cli() -> None:
    """Shaker, synchronised cameras, and vibration measured from motion blur.

    LABDAEMON_ADDRESS is the commands address of the daemon that submit, status, watch, stop and the like talk to, and
    LABDAEMON_KEY the client's key file where that daemon asks for one.
    """


def say(line: str) -> None:
    """Write one line to stderr, unless its reader does not read: the end of a process waits for no reader.

    What a file's name may hold and a line may not (line ends, escapes of a terminal, bytes that are no text) is written
    as Python writes it in a string.
    """
    line = "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in line)
    poll = select.poll()
    try:
        poll.register(sys.stderr.fileno(), select.POLLOUT)
    except (OSError, ValueError):  # no descriptor: it is captured by a test
        click.echo(line, err=True)
        return
    if poll.poll(STDERR_MS):
        click.echo(line[: select.PIPE_BUF - 1], err=True)


def _usage_line(error: click.ClickException) -> str:
    """What is wrong with a command line, and where its help is; Click itself writes three lines."""
    message = " ".join(error.format_message().split())
    context = getattr(error, "ctx", None)
    return f"{message} ({context.command_path} --help says more)" if context is not None else message


def main() -> None:
    """Entry point of the `labdaemon` command.

    Exit status: 0 done, 2 wrong usage or unusable input (one line on stderr), 1 it failed, 130 on Ctrl-C.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    try:
        status = cli.main(standalone_mode=False)
    except click.Abort:
        sys.exit(130)
    except click.exceptions.Exit as exc:
        sys.exit(exc.exit_code)
    except click.exceptions.NoArgsIsHelpError as exc:
        exc.show()
        sys.exit(2)
    except click.ClickException as exc:
        say(f"labdaemon: {_usage_line(exc)}")
        print_error(exc, 2)
        sys.exit(2)
    except LabdaemonError as exc:
        say(f"labdaemon: {exc}")
        print_error(exc, exc.exit_status)
        sys.exit(exc.exit_status)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; say nothing at exit either
        sys.exit(1)
    sys.exit(status if isinstance(status, int) else 0)
