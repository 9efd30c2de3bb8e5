"""Subcommands against a daemon's real sockets with small handlers behind them."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labdaemon.cli.main import COMMANDS, main
from labdaemon.clock import SystemClock
from labdaemon.errors import LimitError
from labdaemon.journal.event import EventText, StoredEvent, limit_bytes
from labdaemon.stream.commands import CommandServer
from labdaemon.stream.messages import RawJson, WrongStateError
from labdaemon.stream.publisher import EventPublisher, replay

CAMPAIGN = Path(__file__).parents[2] / "config" / "campaigns" / "three-modes.toml"
STATUS = {
    "state": "running",
    "campaign": "c-1",
    "name": "three-modes",
    "step": 1,
    "steps": 4,
    "label": "00001-steps-5.000hz",
    "doing": "settling",
    "frequency_hz": 5.0,
    "amplitude_mm": 2.0,
    "captures": 3,
    "captures_total": 6,
    "left_s": 75.0,
    "largest_mm": 6.125,
    "faults": 1,
    "queue": 0,
}
TARGETS = [
    {"target": "L01", "ax_mm": 3.0, "ay_mm": 4.0, "az_mm": 0.0, "bx_mm": 0.0, "by_mm": 0.0, "bz_mm": 0.0, "flags": []},
    {"target": "L02", "ax_mm": None, "ay_mm": None, "az_mm": None, "flags": ["occluded"]},
]
HISTORY: list[tuple[str, dict[str, Any]]] = [
    ("campaign.started", {}),
    ("step.started", {"step": 1, "label": "00001-steps-5.000hz", "frequency_hz": 5.0, "amplitude_mm": 2.0}),
    ("capture.completed", {"capture": "00001-steps-5.000hz", "step": 1}),
    ("envelope", {"capture": "00001-steps-5.000hz", "targets": TARGETS}),
    ("fault", {"device": "left", "message": "left: no answer", "action": "retry"}),
    ("step.completed", {"step": 1}),
    ("campaign.completed", {}),
]


class Daemon:
    """Sockets as a daemon has them, and a record of what was asked."""

    uuid = "journal-1"

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.events = [
            StoredEvent(seq, "2026-05-04T10:11:12.000000Z", kind, "c-1", data, self.uuid)
            for seq, (kind, data) in enumerate(HISTORY, 1)
        ]
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main()))

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        return limit_bytes((event.text() for event in self.events[seq : seq + limit]), most_bytes)

    history = recent

    async def _main(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        publisher = EventPublisher("tcp://127.0.0.1:*", self, lambda: STATUS, SystemClock())
        publisher.bind()
        answers: dict[str, Any] = {
            "status": STATUS,
            "rig": {"service": {"events": publisher.address}},
            "campaign.submit": {"campaign": "c-1"},
            "campaign.pause": {"campaign": "c-1"},
            "campaign.abort": WrongStateError("no campaign is running"),
            "campaign.resume": {"campaign": "c-1"},
            "capture": {"capture": "manual-1", "opened_at": "2026-05-04T10:11:12.000000Z"},
            "stop": {},
        }
        server = CommandServer(
            "tcp://127.0.0.1:*",
            {name: self._handler(name, answer) for name, answer in answers.items()} | {"events.replay": self._replay},
        )
        server.bind()
        self.address = server.address
        self._ready.set()
        tasks = [asyncio.create_task(publisher.run()), asyncio.create_task(server.run())]
        await self._stop.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        publisher.close()
        server.close()

    async def _replay(self, params: dict[str, Any]) -> RawJson:
        return replay(self, params)

    def _handler(self, name: str, answer: Any) -> Any:
        async def handle(params: dict[str, Any]) -> Any:
            self.asked.append((name, params))
            if isinstance(answer, Exception):
                raise answer
            if name == "campaign.submit" and "80.0" in params["toml"]:
                raise LimitError("beyond the stroke", source="campaign", key="phase[1].amplitude_mm[0]")
            return answer

        return handle

    def __enter__(self) -> Daemon:
        self._thread.start()
        assert self._ready.wait(60)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(60)


@pytest.fixture(scope="module")
def daemon() -> Iterator[Daemon]:
    with Daemon() as daemon:
        yield daemon


def labdaemon(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, str, str]:
    """Run the command as a person would; exit status, stdout, stderr."""
    monkeypatch.setattr("sys.argv", ["labdaemon", *args])
    with pytest.raises(SystemExit) as caught:
        main()
    out, err = capsys.readouterr()
    status = caught.value.code
    return (status if isinstance(status, int) else 0), out, err


@pytest.fixture
def run(daemon: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    return lambda *args: labdaemon(monkeypatch, capsys, *args, "--address", daemon.address)


def test_submit_sends_the_text_under_an_id_of_its_own(daemon: Daemon, run: Any) -> None:
    assert run("submit", str(CAMPAIGN)) == (0, "campaign c-1 submitted\n", "")
    name, params = daemon.asked[-1]
    assert (name, params["toml"]) == ("campaign.submit", CAMPAIGN.read_text())
    assert len(params["request_id"]) > 16
    run("submit", str(CAMPAIGN), "--request-id", "mine", "--json")
    assert daemon.asked[-1][1]["request_id"] == "mine"


def test_a_campaign_that_is_wrong_is_not_sent(daemon: Daemon, run: Any, tmp_path: Path) -> None:
    before = len(daemon.asked)
    (tmp_path / "bad.toml").write_text("name = 'x'\n[[phase]]\nkind = 'stepz'")
    status, out, err = run("submit", str(tmp_path / "bad.toml"))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "bad.toml: phase[0]: unknown kind 'stepz'" in err
    assert len(daemon.asked) == before


def test_a_campaign_beyond_the_limits_exits_2_with_the_key(run: Any, tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text(CAMPAIGN.read_text().replace("[2.0,", "[80.0,"))
    status, _, err = run("submit", str(tmp_path / "far.toml"))
    assert status == 2
    assert err == "labdaemon: campaign: phase[1].amplitude_mm[0]: beyond the stroke\n"


def test_status_for_people_and_for_programs(run: Any) -> None:
    status, out, _ = run("status")
    assert status == 0
    assert out.splitlines() == [
        "state      running",
        "campaign   c-1 (three-modes)",
        "step       2 of 4: 00001-steps-5.000hz, 5 Hz, 2 mm, settling",
        "captures   3 of 6",
        "time left  1:15",
        "largest    6.125 mm",
        "faults     1",
    ]
    assert json.loads(run("status", "--json")[1]) == STATUS


@pytest.mark.parametrize(
    ("args", "asked", "said"),
    [
        (("pause",), ("campaign.pause", {}), "campaign c-1 paused\n"),
        (("resume", "c-1"), ("campaign.resume", {"campaign": "c-1"}), "campaign c-1 resumed\n"),
        (("stop",), ("stop", {}), "the shaker is at rest\n"),
    ],
)
def test_commands_say_what_they_did(
    daemon: Daemon, run: Any, args: tuple[str, ...], asked: tuple[str, dict[str, Any]], said: str
) -> None:
    assert run(*args) == (0, said, "")
    assert daemon.asked[-1] == asked
    assert isinstance(json.loads(run(*args, "--json")[1]), dict)


def test_a_refusal_is_one_line_and_exit_1(run: Any) -> None:
    assert run("abort") == (1, "", "labdaemon: no campaign is running\n")


def test_capture_tells_when_it_opened(daemon: Daemon, run: Any) -> None:
    assert run("capture", "--label", "door") == (0, "capture manual-1 opened at 2026-05-04T10:11:12.000000Z\n", "")
    assert daemon.asked[-1][1]["label"] == "door"


def test_watch_prints_a_line_for_what_happens(run: Any) -> None:
    status, out, _ = run("watch", "--after", "0", "--until-end")
    assert status == 0
    assert out.splitlines() == [
        "10:11:12 started    campaign c-1",
        "10:11:12 step       00001-steps-5.000hz, 5 Hz, 2 mm",
        "10:11:12 capture    00001-steps-5.000hz",
        "10:11:12 envelope   00001-steps-5.000hz: 1 of 2 targets, 1 flagged, largest 5.000 mm at L01",
        "10:11:12 FAULT      left: no answer (retry)",
        "10:11:12 completed  campaign c-1",
    ]


def test_watch_as_json_prints_events_as_they_came(run: Any) -> None:
    lines = run("watch", "--after", "0", "--until-end", "--json")[1].splitlines()
    seqs = [event["seq"] for event in map(json.loads, lines) if event["kind"] != "status"]
    assert seqs == list(range(1, len(HISTORY) + 1))


def test_watch_gives_up_when_the_daemon_has_ended(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = ["--events", "tcp://127.0.0.1:9", "--address", "tcp://127.0.0.1:9", "--patience", "1"]
    status, out, err = labdaemon(monkeypatch, capsys, "watch", *silent)
    assert (status, out) == (1, "")
    assert err == "labdaemon: nothing from tcp://127.0.0.1:9 for 1 s: has the daemon ended?\n"


@pytest.mark.parametrize("command", ["status", "pause", "stop", "watch", "capture"])
def test_no_daemon_is_one_line_at_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    status, out, err = labdaemon(monkeypatch, capsys, command, "--address", "tcp://127.0.0.1:9")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert "labdaemon run" in err


def test_an_address_that_is_none_is_wrong_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert labdaemon(monkeypatch, capsys, "status", "--address", "5570")[0] == 2


def test_help_lists_every_command_without_importing_any() -> None:
    code = (
        "import sys; from click.testing import CliRunner; from labdaemon.cli.main import cli\n"
        "print(CliRunner().invoke(cli, ['--help']).output); assert not {'cv2', 'zmq', 'numpy'} & set(sys.modules)"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert all(re.search(rf"^  {name}  +\S", shown, re.M) for name in COMMANDS)
