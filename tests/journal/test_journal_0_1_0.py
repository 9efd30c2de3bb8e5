"""A journal that labdaemon 0.1.0 wrote: it opens, replays what is stored as it is, and goes on counting."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.events import CampaignPaused, EnvelopeMeasured, parse_event
from labdaemon.journal import transitions
from labdaemon.journal.journal import FILE_NAME, Journal
from labdaemon.stream.publisher import latest, replay

SCRIPT = Path(__file__).parent / "journal_0_1_0.sql"
UUID = "5d0c1c8e-0000-4000-8000-000000000010"


@pytest.fixture
def old(tmp_path: Path) -> Iterator[Journal]:
    writer = sqlite3.connect(tmp_path / FILE_NAME)
    writer.executescript(SCRIPT.read_text(encoding="utf-8"))
    writer.close()
    journal = Journal(tmp_path, SimulatedClock())
    yield journal
    journal.close()


def test_it_replays_the_stored_json_as_it_is(old: Journal) -> None:
    answer = replay(old, {"after": 0}).text
    document = json.loads(answer)
    assert [event["seq"] for event in document["events"]] == [1, 2, 3, 4, 5, 6]
    assert (document["last"], document["journal"]) == (6, UUID)
    assert "gone_before" not in document
    stored = [data for (data,) in old.read("SELECT data FROM events ORDER BY seq")]
    assert all(data.encode() in answer for data in stored)  # spaces included


def test_its_events_are_typed(old: Journal) -> None:
    events = [parse_event(text.json) for text in old.history(0, 100, 1 << 20)]
    envelope, paused = events[3], events[5]
    assert isinstance(envelope, EnvelopeMeasured)
    assert envelope.journal == UUID
    first, second = envelope.data.targets
    assert (first.ax_mm, first.sd_ax_mm, first.sign, first.flags) == (0.4, None, None, ("at_rest",))
    assert second.x_mm is None
    assert envelope.data.envelope()["T01"].amplitude_mm == pytest.approx(0.5)
    assert isinstance(paused, CampaignPaused)
    assert paused.data.reason == "left: no answer"


def test_its_seq_continues(old: Journal) -> None:
    assert transitions.move_campaign(old, "0001-night", "running")
    [event] = json.loads(replay(old, {"after": 6}).text)["events"]
    assert (event["seq"], event["kind"], event["journal"]) == (7, "campaign.resumed", UUID)
    kinds = [event["kind"] for event in json.loads(latest(old, {}).text)["events"]]
    assert kinds == [
        "campaign.started", "step.started", "capture.completed", "envelope", "fault", "campaign.paused",
        "campaign.resumed",
    ]  # fmt: skip
