"""A whole daemon that asks for keys: started, commanded, stopped from beside it, and a client put out."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labdaemon.cli.main import cli
from labdaemon.stream.client import Client, NoDaemon, RemoteError


def labdaemon(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "labdaemon", *map(str, arguments)], capture_output=True, text=True, timeout=300
    )


def in_process(*arguments: object) -> str:
    done = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done
    return done.output


def test_off_loopback_without_keys_it_exits_2_in_one_line(config: Path) -> None:
    config.write_text(config.read_text().replace("tcp://127.0.0.1:", "tcp://0.0.0.0:"))
    done = labdaemon("run", config)
    assert done.returncode == 2
    [line] = [line for line in done.stderr.splitlines() if line.startswith("labdaemon: ")]
    assert "service.commands: tcp://0.0.0.0:" in line
    assert "labdaemon keys make" in line
    assert "Traceback" not in done.stderr


def test_a_daemon_with_keys(config: Path, tmp_path: Path, start_daemon: Any, daemons: list[Any]) -> None:
    text = config.read_text().replace("tcp://127.0.0.1:", "tcp://0.0.0.0:")  # also through this machine's other names
    config.write_text(text)
    for name, role in (("olga", "operator"), ("otto", "observer")):
        assert (
            labdaemon("keys", "make", config, name, "--role", role, "--out", tmp_path / f"{name}.key").returncode == 0
        )
    daemons.append(start_daemon(config, tmp_path / "data").ready())
    commands, events = (daemons[0].addresses[name].replace("0.0.0.0", "127.0.0.1") for name in ("commands", "events"))
    with Client(commands, events, timeout_s=60, key=tmp_path / "otto.key") as observer:
        heard = observer.events(timeout_s=60)
        assert next(heard)["kind"] == "status"
        with pytest.raises(RemoteError, match="for operators"):
            observer.call("stop")
        assert in_process("stop", "--address", commands, "--key", tmp_path / "olga.key") == "the shaker is at rest\n"
        beside = labdaemon("safe-stop", config)
        assert (beside.returncode, "by the daemon" in beside.stdout) == (0, True), beside.stderr
        in_process("keys", "revoke", config, "otto")
        observer.timeout_s = 3.0
        heard.close()
        with pytest.raises((NoDaemon, RemoteError)):
            ask_for(observer, seconds=60.0)


def ask_for(client: Client, seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        client.call("status")
        time.sleep(0.05)
