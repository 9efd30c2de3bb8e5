"""How the world's bench waits for its daemon: what it takes for idle, and what it says of a wait in vain."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from labdaemon.bench.kill import small_rig
from labdaemon.bench.world import disk
from labdaemon.bench.world import subject as module
from labdaemon.bench.world.subject import NotInTime, Subject, wait_for
from labdaemon.errors import LabdaemonError
from labdaemon.service.config import load_rig

IDLE = {"state": "idle", "campaign": None, "queue": 0}


class FakeSubject(Subject):
    """A daemon that only answers."""

    def __init__(self, folder: Path, **status: Any) -> None:
        self.folder, self.campaigns = folder, 0
        self.status: dict[str, Any] | LabdaemonError = {**IDLE, **status}
        self.asked: list[str] = []
        (folder / "daemon.log").write_text("one\nthe last line\n")

    def ask(self, method: str, **params: Any) -> Any:
        self.asked.append(method)
        if isinstance(self.status, LabdaemonError):
            raise self.status
        return self.status


@pytest.mark.parametrize(
    ("status", "is_idle"),
    [
        ({}, True),
        ({"state": "starting"}, False),  # what an earlier daemon left is not known yet
        ({"state": "running", "campaign": "0001-world"}, False),
        ({"state": "paused", "campaign": "0001-world"}, False),
        ({"queue": 1}, False),
    ],
)
def test_a_daemon_that_starts_is_not_idle(tmp_path: Path, status: dict[str, Any], is_idle: bool) -> None:
    assert FakeSubject(tmp_path, **status).is_idle() is is_idle


@pytest.mark.parametrize(
    ("status", "commands", "campaigns"),
    [
        ({}, ["status", "campaign.submit"], 1),
        ({"state": "starting"}, ["status"], 0),
        ({"state": "running", "campaign": "0001-world"}, ["status"], 0),
        ({"state": "paused", "campaign": "0001-world"}, ["status", "campaign.resume"], 0),
    ],
)
def test_one_campaign_is_submitted_where_there_is_none(
    tmp_path: Path, status: dict[str, Any], commands: list[str], campaigns: int
) -> None:
    daemon = FakeSubject(tmp_path, **status)
    assert daemon.keep_busy() is (status.get("state") != "starting")
    assert (daemon.asked, daemon.campaigns) == (commands, campaigns)


@pytest.mark.parametrize("is_silent", [False, True])
def test_a_wait_in_vain_says_what_the_daemon_reports_instead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_silent: bool
) -> None:
    def wait(condition: object) -> None:
        raise NotInTime("did not happen within 1 s")

    monkeypatch.setattr(module, "wait_for", wait)
    daemon = FakeSubject(tmp_path, state="paused")
    if is_silent:
        daemon.status = LabdaemonError("no daemon listens")
    with pytest.raises(LabdaemonError) as raised:
        daemon.wait_until("the table moves", lambda: False)
    text = str(raised.value)
    assert text.startswith("the table moves: did not happen within 1 s; status: ")
    assert ("no daemon listens" if is_silent else "'state': 'paused'") in text
    assert text.endswith("the last line\n")


def test_what_comes_true_is_waited_for_and_what_does_not_is_an_error() -> None:
    turns = iter([False, False, True])
    wait_for(lambda: next(turns))
    with pytest.raises(NotInTime, match=r"within 0\.05 s"):
        wait_for(lambda: False, 0.05)


@pytest.mark.slow
def test_the_rig_files_of_the_benches_are_ones_that_a_daemon_takes(tmp_path: Path) -> None:
    """Each section changes the simulated rig's file; a slip there was found only when the section was run whole."""
    with small_rig(1, enable_wired=False) as rig:
        for place, make in enumerate((disk.daemon_on_any_disk, Subject)):
            folder = tmp_path / str(place)
            folder.mkdir()
            interlocks = load_rig(make(rig, folder).config).interlocks
            assert interlocks.accept_no_enable
            assert (interlocks.min_disk_bytes == 0) is (make is disk.daemon_on_any_disk)


def test_a_table_that_never_moves_is_reported_with_the_daemons_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = FakeSubject(tmp_path)
    monkeypatch.setattr(daemon, "start", lambda: None)
    monkeypatch.setattr(daemon, "submit", lambda captures: None)
    monkeypatch.setattr(disk, "_until", lambda condition, timeout_s=0.0: False)
    with pytest.raises(LabdaemonError, match=r"never moved; the daemon's log: one\nthe last line"):
        disk._campaign(daemon, None, disk.locked, random.Random(1))
