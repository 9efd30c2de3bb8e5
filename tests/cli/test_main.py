"""The command line as a whole: every command can be asked for help, and errors are one line."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from labdaemon.cli.main import COMMANDS, cli


def helps(command: click.Command, path: tuple[str, ...]) -> list[tuple[str, ...]]:
    if not isinstance(command, click.Group):
        return [path]
    context = click.Context(command)
    return [
        path,
        *(found for name in command.list_commands(context) for found in members(command, context, name, path)),
    ]


def members(group: click.Group, context: click.Context, name: str, path: tuple[str, ...]) -> list[tuple[str, ...]]:
    command = group.get_command(context, name)
    assert command is not None, name
    return helps(command, (*path, name))


def test_every_command_answers_help() -> None:
    paths = helps(cli, ())
    assert {path[0] for path in paths if path} == set(COMMANDS)
    for path in paths:
        done = CliRunner().invoke(cli, [*path, "--help"])
        assert done.exit_code == 0, (path, done.output)
        assert "Usage:" in done.output


@pytest.mark.parametrize(
    "arguments",
    [["no-such-command"], ["process"], ["process", "/nonexistent"], ["measure", "/nonexistent.dng"], ["run", "/nope"]],
)
def test_wrong_usage_exits_2_without_a_traceback(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "labdaemon", *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr.strip()
