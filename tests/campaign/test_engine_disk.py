"""The engine while the disk takes nothing, or refuses one campaign."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from labdaemon.capture.paths import campaign_folder
from labdaemon.errors import StorageError, StorageFull, StorageUnavailable
from labdaemon.journal import records
from labdaemon.testing.lab import FakeLab

CAMPAIGN = """
name = "disk"
[[phase]]
kind = "sharp"
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0]
amplitude_mm = 1.0
"""


@contextmanager
def full(lab: FakeLab) -> Iterator[None]:
    """No room for the journal to grow."""
    pages = lab.journal._writer.execute("PRAGMA page_count").fetchone()[0]
    lab.journal._writer.execute(f"PRAGMA max_page_count = {pages}")
    # Even what fits the pages that are there is refused, as a full disk does.
    lab.free_bytes = 0
    yield
    lab.free_bytes = 10**12
    lab.journal._writer.execute("PRAGMA max_page_count = 100000")


@contextmanager
def locked(lab: FakeLab) -> Iterator[None]:
    """Another process holds the journal's lock."""
    lab.journal._writer.execute("PRAGMA busy_timeout = 1")
    other = sqlite3.connect(lab.data / "journal.db", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    yield
    other.execute("ROLLBACK")
    other.close()


TROUBLES = pytest.mark.parametrize("trouble", [full, locked])


async def moves(lab: FakeLab) -> None:
    while not lab.world.moves():
        await lab.clock.sleep(0.5)


def kinds(lab: FakeLab) -> list[str]:
    return [event.kind for event in lab.journal.events_after(0, 1000)]


@TROUBLES
def test_a_campaign_rests_while_the_journal_takes_nothing_and_ends_by_itself(simulate: Callable, trouble: Callable):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        await moves(lab)
        with trouble(lab):
            await lab.clock.sleep(30.0)
            assert not lab.world.moves()
            assert lab.engine.step_runner.activity == "waiting for the disk"
            assert lab.engine.reporter.disk_trouble is not None
            await lab.clock.sleep(600.0)
            assert not lab.world.moves()
        assert (await lab.until(id)).state == "completed"
        assert lab.engine.reporter.disk_trouble is None
        events = lab.journal.events_after(0, 1000)
        assert [event.seq for event in events] == list(range(1, len(events) + 1))
        waits = [event.data for event in events if event.kind == "fault" and event.data["action"] == "waited"]
        assert [data["device"] for data in waits] == ["disk"]
        assert [event.kind for event in events].count("envelope") == 2

    simulate(scenario)


@TROUBLES
def test_stop_is_answered_while_the_journal_takes_nothing(simulate: Callable, trouble: Callable):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        await moves(lab)
        with trouble(lab):
            async with asyncio.timeout(5.0):
                await lab.engine.stop()
            assert not lab.world.moves()
            await lab.clock.sleep(60.0)
        assert (await lab.until(id, "paused")).reason == "stopped by a person"
        await lab.clock.sleep(60.0)
        assert not lab.world.moves()

    simulate(scenario)


def test_an_idle_daemon_refuses_a_campaign_that_it_cannot_keep_and_takes_the_next(simulate: Callable):
    async def scenario(lab: FakeLab) -> None:
        with locked(lab):
            await lab.clock.sleep(60.0)
            with pytest.raises(StorageUnavailable, match="locked"):
                await lab.submit(CAMPAIGN)
        assert (await lab.until(await lab.submit(CAMPAIGN))).state == "completed"

    simulate(scenario)


def test_a_folder_that_cannot_be_made_fails_its_campaign_and_no_other(simulate: Callable):
    async def scenario(lab: FakeLab) -> None:
        campaign_folder(lab.data, "0001-disk").parent.mkdir(parents=True)
        campaign_folder(lab.data, "0001-disk").write_text("a file is in the way")
        first, second = await lab.submit(CAMPAIGN), await lab.submit(CAMPAIGN)
        record = await lab.until(first)
        assert record.state == "failed"
        assert "0001-disk" in (record.reason or "")
        assert (await lab.until(second)).state == "completed"

    simulate(scenario)


def test_results_that_cannot_be_written_pause_the_campaign_at_its_end(simulate: Callable):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        await moves(lab)
        lab.measurer.refuses = StorageError("cannot be written (read-only disk)", file="results")
        record = await lab.until(id)
        assert record.state == "paused"
        assert "read-only disk" in (record.reason or "")
        assert kinds(lab).count("envelope") == 2
        lab.measurer.refuses = None
        await lab.engine.resume()
        assert (await lab.until(id)).state == "completed"
        assert len(lab.measurer.results[campaign_folder(lab.data, id)]) == 2

    simulate(scenario)


def test_results_wait_for_a_full_disk_before_the_campaign_is_completed(simulate: Callable):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        await moves(lab)
        lab.measurer.refuses = StorageFull("the disk is full", file="results")
        await lab.clock.sleep(3600.0)
        assert records.campaign(lab.journal, id).state == "running"
        assert not lab.world.moves()
        lab.measurer.refuses = None
        assert (await lab.until(id)).state == "completed"
        assert len(lab.measurer.results[campaign_folder(lab.data, id)]) == 2

    simulate(scenario)


def test_results_that_were_cut_are_written_anew_at_the_start(simulate: Callable):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        assert (await lab.until(id)).state == "completed"
        results = lab.measurer.results[campaign_folder(lab.data, id)]
        await lab.kill()
        results.pop()
        lab.start()
        await lab.clock.sleep(1.0)
        assert len(lab.measurer.results[campaign_folder(lab.data, id)]) == 2

    simulate(scenario)


def test_a_disk_that_does_not_answer_brings_the_table_to_rest(simulate: Callable, tmp_path: Path):
    async def scenario(lab: FakeLab) -> None:
        id = await lab.submit(CAMPAIGN)
        await moves(lab)

        def vanished() -> int:
            raise OSError(5, "Input/output error")

        answer, lab.engine.disk._free_bytes = lab.engine.disk._free_bytes, vanished
        await lab.clock.sleep(30.0)
        assert not lab.world.moves()
        assert "does not answer" in (lab.engine.reporter.disk_trouble or "")
        lab.engine.disk._free_bytes = answer
        assert (await lab.until(id)).state == "completed"

    simulate(scenario)
