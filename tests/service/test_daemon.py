"""`labdaemon run` as a process of its own, on a simulated rig in another."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

STEPS = """
name = "steps"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = [6.0, 9.0]
amplitude_mm = 0.5
exposure_s = 0.25
settle = { max_change_per_cycle = 0.05, timeout_s = 30 }
"""


@pytest.fixture
def run(config: Path, tmp_path: Path, daemons: list[Any], start_daemon: Callable[..., Any]) -> Callable[..., Any]:
    def start(*options: str, config: Path = config, data: Path = tmp_path / "data") -> Any:
        daemons.append(start_daemon(config, data, *options))
        return daemons[-1]

    return start


def until(condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come to that in time"
        time.sleep(0.05)


def test_a_shaking_table_comes_to_rest_when_it_is_told_to_end(run, rig):
    daemon = run().ready()
    daemon.ask("campaign.submit", toml=STEPS)
    until(lambda: rig.table()["moving"])
    status, _ = daemon.end(signal.SIGTERM)
    assert status == 0
    assert not rig.table()["moving"]
    again = run().ready()
    until(lambda: again.ask("status")["campaign"] is None)
    kinds = [event["kind"] for event in again.ask("events.replay", after=0)["events"]]
    assert kinds.count("campaign.completed") == 1
    assert again.end(signal.SIGINT)[0] == 130


def test_stop_brings_it_to_rest_and_pauses(run, rig):
    daemon = run().ready()
    id = daemon.ask("campaign.submit", toml=STEPS, request_id="one")["campaign"]
    assert daemon.ask("campaign.submit", toml=STEPS, request_id="one")["campaign"] == id
    until(lambda: rig.table()["moving"])
    assert daemon.ask("stop")["rest"] == "soft"
    until(lambda: not rig.table()["moving"], 5.0)
    assert daemon.ask("status")["state"] == "paused"
    assert daemon.end()[0] == 0


def test_a_second_daemon_is_refused_and_disturbs_nothing(run, tmp_path: Path):
    first = run().ready()
    status, err = run().end(0)
    assert status == 2
    assert "another labdaemon (process" in err
    status, err = run(data=tmp_path / "other").end(0)
    assert status == 2
    assert "is taken, most likely by a daemon that runs already" in err
    assert first.ask("status")["state"] == "idle"


@pytest.mark.parametrize("answer", [None, b"\xff\x00\xfe~\x81{" * 20])
def test_a_shaker_that_never_answers_or_answers_rubbish(run, config: Path, rig, answer: bytes | None):
    server = socket.create_server(("127.0.0.1", 0))

    def talk() -> None:
        client, _ = server.accept()
        with client:
            while client.recv(100):
                if answer is not None:
                    client.sendall(answer)

    threading.Thread(target=talk, daemon=True).start()
    port = f"socket://127.0.0.1:{server.getsockname()[1]}"
    config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], port))
    began = time.monotonic()
    status, err = run().end(0)
    server.close()
    assert status == 1
    [line] = [line for line in err.splitlines() if line.startswith("labdaemon: ")]
    assert "shaker: " in line
    assert "Traceback" not in err
    assert time.monotonic() - began < 60.0


def test_a_port_that_does_not_open(run, config: Path, rig, tmp_path: Path):
    config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], "/dev/nonexistent"))
    status, err = run().end(0)
    assert status == 1
    assert "labdaemon: shaker: port /dev/nonexistent does not open" in err
    assert not (tmp_path / "data" / "journal.db").exists()


def test_an_unknown_driver(run, config: Path):
    config.write_text(config.read_text().replace('driver = "scpi"', 'driver = "scpy"'))
    status, err = run().end(0)
    assert status == 2
    assert "did you mean scpi?" in err


def test_a_damaged_journal_is_refused_with_the_table_at_rest(run, rig, tmp_path: Path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "journal.db").write_bytes(b"no journal" * 1000)
    status, err = run().end(0)
    assert status == 2
    assert "--new-journal" in err
    assert not rig.table()["moving"]
    daemon = run("--new-journal").ready()
    assert daemon.ask("status")["seq"] == 0
    assert len(list((tmp_path / "data").glob("journal.damaged-*"))) == 1
