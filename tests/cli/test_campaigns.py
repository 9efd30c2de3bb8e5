"""`labdaemon rig` and `labdaemon campaigns`, over real sockets to a light daemon; errors as JSON; two daemons."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labdaemon.cli.error_json import is_asked_for
from labdaemon.cli.main import main
from labdaemon.service.presence import PresenceNote, present_daemons
from labdaemon.stream.listener import SocketFile
from labdaemon.stream.sockets import DoorPolicy
from labdaemon.testing.stream_daemon import StreamDaemon

FIRST: dict[str, Any] = {
    "id": "0001-first", "name": "first", "state": "paused", "reason": "asked for", "place": None,
    "submitted_at": "2026-05-04T10:11:12.000000Z", "folder": "/d/0001-first", "results": "/d/0001-first/results",
}  # fmt: skip
SECOND = FIRST | {"id": "0002-second", "state": "queued", "reason": None, "place": 0}

STEP = {"step": 0, "state": "done", "attempts": 1, "reason": None}

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def daemon() -> Iterator[StreamDaemon]:
    daemon = StreamDaemon()
    daemon.results |= {
        "campaign.list": {"campaigns": [SECOND, FIRST], "total": 2},
        "campaign.show": FIRST | {"toml": "", "captures": 3, "steps": [STEP]},
        "campaign.move": {"campaign": "0002-second", "queue": ["0002-second"]},
        "rig": {
            "version": "1", "pid": 7, "config": "/etc/labdaemon/rig.toml", "devices": {"left": "Nikon D80 6000001"},
            "service": {"commands": "tcp://a", "events": "tcp://b", "data": "/d"}, "limits": {"stroke_mm": 150.0},
        },
    }  # fmt: skip
    daemon.start()
    yield daemon
    daemon.stop()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    monkeypatch.setenv("LABDAEMON_LOCKS", str(tmp_path))

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["labdaemon", *arguments])
        with pytest.raises(SystemExit) as left:
            main()
        said = capsys.readouterr()
        return int(left.value.code or 0), said.out, said.err

    return run


def test_the_rig_says_which_it_is(daemon: StreamDaemon, run: Run) -> None:
    status, out, _ = run("rig", "--address", daemon.commands)
    assert status == 0
    for words in ("/etc/labdaemon/rig.toml", "process 7", "left: Nikon D80", "stroke_mm 150.0", "/d"):
        assert words in out
    assert json.loads(run("rig", "--address", daemon.commands, "--json")[1])["pid"] == 7


def test_campaigns_are_listed_shown_and_moved(daemon: StreamDaemon, run: Run) -> None:
    _, out, _ = run("campaigns", "list", "--address", daemon.commands)
    assert [line.split()[:2] for line in out.splitlines()[1:]] == [["0", "0002-second"], ["0001-first", "paused"]]
    _, out, _ = run("campaigns", "show", "0001-first", "--address", daemon.commands)
    assert "step    0  done, 1 attempts" in out
    assert run("campaigns", "show", "--results", "--address", daemon.commands)[1] == "/d/0001-first/results\n"
    moved = run("campaigns", "move", "0002-second", "--place", "3", "--address", daemon.commands, "--json")[1]
    assert json.loads(moved)["queue"] == ["0002-second"]
    assert ("campaign.move", {"campaign": "0002-second", "place": 3}) in daemon.asked


def test_errors_are_json_where_answers_are(daemon: StreamDaemon, run: Run) -> None:
    status, out, err = run("abort", "--address", daemon.commands, "--json")
    error = json.loads(out)["error"]
    assert (status, error["exit_status"], error["name"], error["code"]) == (1, 1, "method_not_found", -32601)
    assert err == f"labdaemon: {error['message']}\n"
    status, out, _ = run("status", "--address", "tcp://127.0.0.1:9", "--json")
    assert (status, json.loads(out)["error"]["type"]) == (1, "NoDaemon")
    status, out, _ = run("campaigns", "show", "--nonsense", "--json")
    assert (status, json.loads(out)["error"]["exit_status"]) == (2, 2)
    status, out, _ = run("plan", "none.toml", "--json")
    assert (status, "error" in json.loads(out)) == (2, True)
    assert run("status", "--address", "tcp://127.0.0.1:9")[1] == ""


def test_what_follows_two_dashes_is_no_option() -> None:
    assert is_asked_for(["status", "--json"])
    assert not is_asked_for(["submit", "--", "--json"])


@pytest.fixture
def two_daemons(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setenv("LABDAEMON_LOCKS", str(tmp_path))
    notes = []
    for number in (1, 2):
        with monkeypatch.context() as patch:
            patch.setattr("labdaemon.service.presence.os.getpid", lambda number=number: number)
            notes.append(PresenceNote(f"tcp://127.0.0.1:{number}", f"rig-{number}.toml"))
    (tmp_path / "labdaemon-present-3.note").write_text('{"pid": 3, "commands": "x", "config": "killed"}')
    (tmp_path / "labdaemon-present-4.note").mkdir()
    yield
    for note in notes:
        note.remove()


def test_a_warning_names_both_where_no_address_was_given(
    two_daemons: None, run: Run, daemon: StreamDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert [one.config for one in present_daemons()] == ["rig-1.toml", "rig-2.toml"]
    monkeypatch.setattr("labdaemon.cli.remote.ask", lambda *_, **__: {"rest": "none"})
    _, _, err = run("stop")
    assert "2 daemons run on this computer: tcp://127.0.0.1:1 (rig-1.toml" in err
    assert "LABDAEMON_ADDRESS" in err
    assert run("stop", "--address", daemon.commands)[2] == ""
    monkeypatch.setenv("LABDAEMON_ADDRESS", daemon.commands)
    assert run("stop")[2] == ""


def test_a_note_is_gone_with_its_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LABDAEMON_LOCKS", str(tmp_path))
    note = PresenceNote("tcp://127.0.0.1:1", "rig.toml")
    [present] = present_daemons()
    assert present.commands == "tcp://127.0.0.1:1"
    note.remove()
    note.remove()
    assert present_daemons() == []
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("LABDAEMON_LOCKS", str(tmp_path / "none"))
    PresenceNote("tcp://127.0.0.1:1", "rig.toml").remove()


def test_commands_reach_a_daemon_over_a_unix_socket(run: Run, socket_folder: Path) -> None:
    daemon = StreamDaemon(DoorPolicy(place=SocketFile()))
    daemon.commands, daemon.events = f"ipc://{socket_folder}/c.sock", f"ipc://{socket_folder}/e.sock"
    assert run("stop", "--address", daemon.commands)[0] == 1  # no one listens yet
    daemon.start()
    try:
        assert run("stop", "--address", daemon.commands)[:2] == (0, "the shaker is at rest\n")
    finally:
        daemon.stop()
    assert run("stop", "--address", "ipc://c.sock")[0] == 2
