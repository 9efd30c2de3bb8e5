"""The command line as a whole: every command can be asked for help, and errors are one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from labdaemon.cli.main import COMMANDS, ONE_THREAD, cli, main
from labdaemon.errors import LabdaemonError


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
    ("typed", "meant"), [("statsu", "status"), ("process-folder", "process"), ("safestop", "safe-stop")]
)
def test_a_command_that_is_typed_wrong_is_refused_with_the_one_that_was_meant(typed: str, meant: str) -> None:
    done = CliRunner().invoke(cli, [typed])
    assert done.exit_code == 2
    assert f"no command '{typed}'; did you mean {meant}?" in done.output


def test_a_folder_that_is_no_data_set_is_refused_with_where_those_are(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "labdaemon", "process", str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith(f"labdaemon: {tmp_path}: is no data-set folder: it has no rig.toml.")
    assert "labdaemon campaigns list" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        "process X", "verify X", "calibrate camera X", "modes X", "report X", "measure --sharp X X", "plan X",
        "compare X X", "noise-floor X --capture a --capture b",
    ],
)  # fmt: skip
def test_a_name_that_no_file_can_have_is_refused_in_one_line(arguments: str) -> None:
    """Python's own tests for files raise where a name is too long for the file system."""
    done = CliRunner().invoke(cli, arguments.replace("X", "x" * 300).split())
    assert isinstance(done.exception, (LabdaemonError, SystemExit)), done.exception
    assert getattr(done.exception, "exit_status", done.exit_code) == 2


def test_stop_without_a_daemon_says_what_stops_the_table() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "labdaemon", "stop", "--address", "tcp://127.0.0.1:1"], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "use the emergency stop, or `labdaemon safe-stop RIG.toml`" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["no-such-command"], ["process"], ["process", "/nonexistent"], ["measure", "/nonexistent.dng"],
        ["run", "/nope"],
        ["measure", "--sharp", "/", "/"], ["measure", "--method", "x"], ["process", "new\nline\x1b[31m"],
        ["process", b"half\xff"],
    ],
)  # fmt: skip
def test_wrong_usage_exits_2_with_one_line(arguments: list[str | bytes]) -> None:
    done = subprocess.run([sys.executable, "-m", "labdaemon", *arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("labdaemon: ")
    assert done.stderr.count("\n") == 1
    assert done.stderr.strip().isprintable()


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("3", "3")])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, given: str | None, used: str
) -> None:
    for name in ONE_THREAD:
        monkeypatch.setenv(name, "0")  # so that what was there comes back afterwards
        monkeypatch.delenv(name)
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    monkeypatch.setattr(sys, "argv", ["labdaemon", "--version"])
    with pytest.raises(SystemExit):
        main()
    assert os.environ["OPENBLAS_NUM_THREADS"] == used
