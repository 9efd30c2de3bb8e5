"""`labdaemon calibrate`: what is measured once and used for a long time."""

from __future__ import annotations

from importlib import import_module
from typing import cast

import click

KINDS = {
    "camera": ("labdaemon.cli.calibrate_camera:camera", "A camera's lens, from photographs of a board."),
}
"""What can be calibrated -> where its command lives and its line in `--help`."""


class LazyKinds(click.Group):
    """A group whose members are imported on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(KINDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in KINDS:
            return None
        module, _, attribute = KINDS[cmd_name][0].partition(":")
        return cast(click.Command, getattr(import_module(module), attribute))

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in KINDS.items()])


@click.group(cls=LazyKinds)
def calibrate() -> None:
    """Calibrate the measuring equipment."""
