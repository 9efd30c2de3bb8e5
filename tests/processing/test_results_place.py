from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal
from labdaemon.processing.results_place import ResultsFolders, process_in_use


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    """Of this process, with a campaign that runs."""
    journal = Journal(tmp_path, SimulatedClock())
    id = transitions.submit(journal, "x", "", "")
    (tmp_path / "campaigns" / id / "results").mkdir(parents=True)
    transitions.move_campaign(journal, id, "running")
    yield journal
    journal.close()


@pytest.fixture
def folder(journal: Journal) -> Path:
    return journal.folder / "campaigns" / "0001-x"


def test_a_folder_of_nobody_is_written_to_as_always(tmp_path: Path):
    assert ResultsFolders.of(tmp_path).choose() == (tmp_path / "results", None)


@pytest.mark.parametrize("state", ["running", "paused"])
def test_a_campaign_that_has_not_ended_keeps_its_results(journal: Journal, folder: Path, state: str):
    if state == "paused":
        transitions.move_campaign(journal, "0001-x", "paused")
    out, why = ResultsFolders.of(folder).choose()
    assert out == folder / "results-2"
    assert f"process {os.getpid()}" in (why or "")
    out.mkdir()
    assert ResultsFolders.of(folder).choose()[0] == folder / "results-3"


def test_a_campaign_that_has_ended_is_written_to(journal: Journal, folder: Path):
    transitions.move_campaign(journal, "0001-x", "aborted")
    assert ResultsFolders.of(folder).choose() == (folder / "results", None)


def test_a_daemon_that_has_died_keeps_nothing(journal: Journal, folder: Path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (journal.folder / "journal.lock").write_text(f"{dead.pid}\n")
    assert process_in_use(folder) is None


def test_a_journal_that_cannot_be_asked_may_be_in_use(journal: Journal, folder: Path):
    journal._writer.execute("DROP TABLE campaigns")
    assert process_in_use(folder) == os.getpid()


@pytest.mark.parametrize("name", ["envelope.csv", "measurements.csv"])
def test_files_that_changed_meanwhile_are_left_alone(tmp_path: Path, name: str):
    (tmp_path / "results").mkdir()
    place = ResultsFolders.of(tmp_path)
    (tmp_path / "results" / name).write_text("another's")
    out, why = place.choose()
    assert out == tmp_path / "results-2"
    assert "meanwhile" in (why or "")
