"""`labdaemon run` with an amplifier that nothing but the shaker's own commands stop."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow

CAMPAIGN = """
name = "long"
[[phase]]
kind = "sharp"
frames = 1
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = { start = 6, stop = 9, count = 20 }
amplitude_mm = 0.5
exposure_s = 0.25
settle = { max_change_per_cycle = 0.05, timeout_s = 30 }
"""


@pytest.fixture(scope="module")
def rig():
    [entry] = entry_points(group="labdaemon.simulators", name="rig")
    with entry.load()(seed=3, small=True, enable_wired=False) as running:
        yield running


@pytest.fixture
def moving_daemon(config: Path, tmp_path: Path, daemons: list[Any], start_daemon: Callable[..., Any], rig: Any):
    """Starts a daemon on the same rig and data, and has it move the table."""

    text = config.read_text().replace("[interlocks]\n", "[interlocks]\naccept_no_enable = true\n")
    # Deaths are tried here, no hangs: what a busy machine delays must not count as one.
    config.write_text(text.replace("[guardian]\n", "[guardian]\nsilence_s = 30.0\n"))

    def start(*, submit: bool = True) -> Any:
        daemons.append(start_daemon(config, tmp_path / "data"))
        daemon = daemons[-1].ready()
        if submit:
            daemon.ask("campaign.submit", toml=CAMPAIGN)
            until(lambda: rig.table()["moving"])
        return daemon

    return start


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def until(condition: Callable[[], bool], timeout_s: float = 120.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "it did not come to that in time"
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGRTMIN + 3])
def test_every_signal_that_can_be_caught_brings_the_table_to_rest(moving_daemon, rig, number: int):
    daemon = moving_daemon()
    status, _ = daemon.end(number)
    assert status == 128 + number
    assert not rig.table()["moving"]


def test_suspending_it_from_the_terminal_does_nothing(moving_daemon, rig):
    daemon = moving_daemon()
    daemon.process.send_signal(signal.SIGTSTP)
    assert daemon.ask("status")["state"] == "running"
    assert daemon.end()[0] == 0


def test_killed_it_leaves_a_table_at_rest_and_the_next_daemon_says_so(moving_daemon, rig):
    daemon = moving_daemon()
    guardian = daemon.ask("status")["guardian"]["pid"]
    daemon.process.kill()
    daemon.process.wait()
    again = moving_daemon(submit=False)  # it waits for the guardian, if that is still at it
    assert is_gone(guardian)
    events = again.ask("events.replay", after=0)["events"]
    [told] = [event["data"]["message"] for event in events if "guardian" in str(event["data"].get("device"))]
    assert f"process {daemon.process.pid}" in told
    assert "saw it at rest" in told
    assert again.end()[0] == 0


def test_without_its_guardian_the_campaign_pauses_and_goes_on_with_a_new_one(moving_daemon, rig):
    daemon = moving_daemon()
    guardian = daemon.ask("status")["guardian"]["pid"]
    os.kill(guardian, signal.SIGKILL)
    until(lambda: daemon.ask("status")["state"] == "paused")
    until(lambda: not rig.table()["moving"])
    status = daemon.ask("status")
    assert "guardian" in status["reason"]
    until(lambda: daemon.ask("status")["guardian"]["pid"] not in (None, guardian))
    daemon.ask("campaign.resume")
    until(lambda: rig.table()["moving"])
    guardian = daemon.ask("status")["guardian"]["pid"]
    assert daemon.end()[0] == 0
    assert is_gone(guardian)
