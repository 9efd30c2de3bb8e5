"""`labdaemon keys` as a person uses it."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from labdaemon.cli.main import cli
from labdaemon.errors import UsageError
from labdaemon.stream.access import CLIENTS
from labdaemon.stream.key_files import read_pair


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "rig.toml"
    path.write_text("[service]\n")
    return path


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, ["keys", *map(str, arguments)])


def test_a_key_is_made_listed_and_revoked(rig: Path) -> None:
    made = json.loads(run("make", rig, "olga", "--role", "operator", "--json").output)
    assert stat.S_IMODE(os.stat("olga.key").st_mode) == 0o600
    pair = read_pair(Path("olga.key"), is_client=True)
    assert (pair.public, pair.daemon) == (made["public"], made["daemon"])
    assert pair.secret not in json.dumps(made)
    assert run("make", rig, "otto", "--role", "observer").exit_code == 0
    listed = json.loads(run("list", rig, "--json").output)["clients"]
    assert [(one["name"], one["role"]) for one in listed] == [("olga", "operator"), ("otto", "observer")]
    assert "olga is revoked" in run("revoke", rig, "olga").output
    assert "olga" not in run("list", rig).output


def test_a_secret_is_not_written_over_and_nothing_is_listed_then(rig: Path) -> None:
    Path("olga.key").write_text("mine")
    done = run("make", rig, "olga", "--role", "operator")
    assert isinstance(done.exception, UsageError)
    assert Path("olga.key").read_text() == "mine"
    assert run("list", rig).output == "no client is listed\n"


def test_a_secret_that_cannot_be_written_is_not_listed(rig: Path) -> None:
    assert run("make", rig, "olga", "--role", "operator", "--out", "/proc/olga.key").exit_code == 1
    assert json.loads(run("list", rig, "--json").output) == {"clients": []}


def test_slips_exit_2(rig: Path) -> None:
    assert run("make", rig, "olga", "--role", "admin").exit_code == 2
    for arguments in (("make", rig, "a b", "--role", "observer"), ("revoke", rig, "olga"), ("list", "none.toml")):
        done = run(*arguments)
        assert getattr(done.exception, "exit_status", None) == 2, arguments


def test_the_folder_is_the_rig_files(rig: Path) -> None:
    rig.write_text('[service]\nkeys = "elsewhere/k"\n')
    assert run("make", rig, "olga", "--role", "operator").exit_code == 0
    assert (rig.parent / "elsewhere" / "k" / CLIENTS).exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_what_root_makes_belongs_to_the_folders_owner(rig: Path) -> None:
    folder = rig.parent / "keys"
    folder.mkdir()
    os.chown(folder, 65534, 65534)
    assert run("make", rig, "olga", "--role", "operator").exit_code == 0
    assert {path.stat().st_uid for path in folder.iterdir()} == {65534}
    assert stat.S_IMODE((folder / "daemon.key").stat().st_mode) == 0o600
