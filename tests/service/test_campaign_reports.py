"""The page of each campaign that ends, written by a process of its own."""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from labdaemon.service.campaign_reports import CampaignReports


class FakeJournal:
    """Events of campaigns."""

    def __init__(self) -> None:
        self.events: list[tuple[int, str, str]] = []

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def add(self, kind: str, campaign: str) -> None:
        self.events.append((len(self.events) + 1, kind, campaign))

    def read(self, _: str, after: int, *kinds: str) -> list[tuple[str]]:
        return [(campaign,) for seq, kind, campaign in self.events if seq > after and kind in kinds]


@pytest.fixture
def journal() -> FakeJournal:
    return FakeJournal()


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What runs instead of Python; it writes down its arguments."""
    script = tmp_path / "python"
    script.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\ncase "$*" in *bad*) echo no >&2; exit 1;; esac\n')
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    return tmp_path / "asked"


def with_results(data: Path, campaign: str) -> Path:
    folder = data / "campaigns" / campaign
    (folder / "results").mkdir(parents=True)
    (folder / "results" / "envelope.csv").write_text("capture,target\n")
    return folder


async def follow(journal: Any, data: Path, asked: Path, lines: int) -> list[str]:
    """What was asked for, once it is so many lines."""
    reports = CampaignReports(journal, data)
    task = asyncio.create_task(reports.run())
    for kind, campaign in (
        ("campaign.started", "c1"),
        ("campaign.completed", "c1"),
        ("campaign.aborted", "none"),
        ("campaign.failed", "bad"),
        ("campaign.aborted", "c2"),
    ):
        journal.add(kind, campaign)
        reports.wake()
        await asyncio.sleep(0)
    async with asyncio.timeout(60):
        while len(found := asked.read_text().splitlines() if asked.exists() else []) < lines:
            await asyncio.sleep(0.02)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return found


def test_each_campaign_with_results_that_ends_gets_its_page(
    journal: FakeJournal, tmp_path: Path, program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    journal.add("campaign.completed", "before")  # before the daemon's start: its page is there or was not wanted
    folders = [with_results(tmp_path, name) for name in ("before", "c1", "bad", "c2")]
    asked = asyncio.run(follow(journal, tmp_path, program, 3))
    assert asked == [f"-m labdaemon report {folder}" for folder in folders[1:]]
    assert "the report of bad was not written: no" in caplog.text


def test_a_program_that_is_not_there_is_a_warning(
    journal: FakeJournal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with_results(tmp_path, "c1")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))

    async def run() -> None:
        await CampaignReports(journal, tmp_path)._write(tmp_path / "campaigns" / "c1")

    asyncio.run(run())
    assert "labdaemon report writes it" in caplog.text


def test_a_page_that_is_being_written_ends_with_the_daemon(
    journal: FakeJournal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = with_results(tmp_path, "c1")
    script = tmp_path / "endless"
    script.write_text(
        f"#!/bin/sh\necho $$ > {tmp_path}/pid.new; mv {tmp_path}/pid.new {tmp_path}/pid; exec sleep 600\n"
    )
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))

    async def run() -> None:
        task = asyncio.create_task(CampaignReports(journal, tmp_path)._write(folder))
        async with asyncio.timeout(60):
            while not (tmp_path / "pid").exists():
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(run())
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
