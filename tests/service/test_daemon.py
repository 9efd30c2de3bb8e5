"""`labdaemon run` as a process of its own, on a simulated rig in another."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from labdaemon.testing.free_port import free_port

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


def until(condition: Callable[[], bool], timeout_s: float = 120.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come to that in time"
        time.sleep(0.05)


def test_a_shaking_table_comes_to_rest_when_it_is_told_to_end(run, rig, config: Path, tmp_path: Path):
    config.write_text(config.read_text().replace("reports = false", "reports = true"))
    daemon = run().ready()
    daemon.ask("campaign.submit", toml=STEPS)
    until(lambda: rig.table()["moving"])
    status, _ = daemon.end(signal.SIGTERM)
    assert status == 0
    assert not rig.table()["moving"]
    again = run().ready()

    def kinds() -> list[str]:
        return [event["kind"] for event in again.ask("events.replay", after=0)["events"]]

    # Its status names no campaign either before it has taken this one up.
    until(lambda: "campaign.completed" in kinds())
    until(lambda: again.ask("status")["campaign"] is None)
    assert kinds().count("campaign.completed") == 1
    page = "campaigns/*/results/index.html"  # of a process of low priority
    until(lambda: any((tmp_path / "data").glob(page)), timeout_s=400.0)
    assert again.end(signal.SIGINT)[0] == 130


def test_a_second_daemon_is_refused_and_stop_brings_the_table_to_rest_and_pauses(run, rig, tmp_path: Path):
    """Both of one daemon whose table moves for as long as need be."""
    first = run().ready()
    campaign = STEPS.replace("timeout_s = 30", "timeout_s = 90").replace("0.05", "1e-9")
    id = first.ask("campaign.submit", toml=campaign, request_id="one")["campaign"]
    assert first.ask("campaign.submit", toml=campaign, request_id="one")["campaign"] == id
    until(lambda: str(first.ask("status")["kind"]) == "steps" and rig.table()["moving"])
    for data in (tmp_path / "data", tmp_path / "other"):
        status, err = run(data=data).end(0)
        assert status == 2
        assert f"another labdaemon (process {first.process.pid}" in err
    status = first.ask("status")
    assert (status["state"], status["faults"], rig.table()["moving"]) == ("running", 0, True), status
    assert first.ask("stop")["rest"] == "soft"
    until(lambda: not rig.table()["moving"])
    assert first.ask("status")["state"] == "paused"
    assert first.end()[0] == 0


@pytest.mark.parametrize("answer", [None, b"\xff\x00\xfe~\x81{" * 20])
def test_a_shaker_that_never_answers_or_answers_rubbish(run, config: Path, rig, answer: bytes | None):
    server = socket.create_server(("127.0.0.1", 0))

    def talk(client: socket.socket) -> None:
        with client, suppress(OSError):
            while client.recv(100):
                if answer is not None:
                    client.sendall(answer)

    def serve() -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=talk, args=(server.accept()[0],), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    port = f"socket://127.0.0.1:{server.getsockname()[1]}"
    config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], port))
    daemon = run().ready()
    assert daemon.ask("status")["table"] == "unconfirmed"
    status, err = daemon.end()
    server.close()
    assert status == 1
    [line] = [line for line in err.splitlines() if line.startswith("labdaemon: ")]
    assert "shaker: " in line
    assert "use the emergency stop" in line
    assert "Traceback" not in err


def test_a_shaker_that_comes_late_is_brought_to_rest_then(run, config: Path, rig):
    address = ("127.0.0.1", free_port())
    config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], "socket://{}:{}".format(*address)))
    daemon = run().ready()
    assert daemon.ask("status")["table"] == "unconfirmed"
    host, number = rig.addresses.ports["shaker"].removeprefix("socket://").split(":")
    with socket.create_server(address) as server:
        threading.Thread(target=forward, args=(server, (host, int(number))), daemon=True).start()
        until(lambda: daemon.ask("status")["table"] == "rest")
        assert daemon.end()[0] == 0


def forward(server: socket.socket, target: tuple[str, int]) -> None:
    with suppress(OSError):
        while True:
            near, far = server.accept()[0], socket.create_connection(target)
            threading.Thread(target=relay, args=(near, far), daemon=True).start()


def relay(near: socket.socket, far: socket.socket) -> None:
    """Pass bytes in both directions until one side ends; both are closed then, by no garbage collection."""
    with near, far:
        back = threading.Thread(target=pump, args=(far, near), daemon=True)
        back.start()
        pump(near, far)
        back.join()


def pump(one: socket.socket, other: socket.socket) -> None:
    with suppress(OSError):
        while data := one.recv(4096):
            other.sendall(data)
    for end in (one, other):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


def test_a_port_that_does_not_open(run, config: Path, rig):
    config.write_text(config.read_text().replace(rig.addresses.ports["shaker"], "/dev/nonexistent"))
    daemon = run().ready()
    assert daemon.ask("status")["table"] == "unconfirmed"
    status, err = daemon.end()
    assert status == 1
    assert "port /dev/nonexistent does not open" in err
    assert "use the emergency stop" in err


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
