"""History is cut from its beginning, and never what is still needed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.retention import LEAST_LEFT, Retention, cut_history, first_to_keep

DAY_S = 86400.0


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def journal(tmp_path: Path, clock: SimulatedClock) -> Iterator[Journal]:
    journal = Journal(tmp_path, clock, synchronous="OFF")
    yield journal
    journal.close()


def add(journal: Journal, count: int, campaign: str | None = None) -> None:
    with journal.transaction("test") as write:
        for _ in range(count):
            write.emit("fault", campaign, {"message": "m"})


def cut(journal: Journal, retention: Retention) -> int:
    """First `seq` that is left."""
    first = first_to_keep(journal, retention)
    while cut_history(journal, first):
        pass
    return journal.events_after(0, 1)[0].seq


def test_nothing_is_cut_unless_it_is_asked_for(journal: Journal) -> None:
    add(journal, 3000)
    assert Retention().is_unlimited
    assert cut(journal, Retention()) == 1


def test_the_newest_are_kept(journal: Journal) -> None:
    add(journal, 6500)
    assert cut(journal, Retention(events=2000)) == 4501
    assert journal.last_seq == 6500
    assert len(journal.events_after(0, 10_000)) == 2000


def test_age_counts_back_from_the_newest(journal: Journal, clock: SimulatedClock) -> None:
    for _ in range(5):
        add(journal, 800)
        clock.advance(DAY_S)
    assert cut(journal, Retention(days=1.5)) == 2401


def test_some_events_always_stay_and_seq_goes_on_after_a_restart(tmp_path: Path, clock: SimulatedClock) -> None:
    journal = Journal(tmp_path, clock, synchronous="OFF")
    add(journal, 3000)
    clock.jump(1000 * DAY_S)  # also what a clock that jumps does
    add(journal, 1)
    assert cut(journal, Retention(days=0.01, events=1000)) == 3001 - LEAST_LEFT + 1
    journal.close()
    journal = Journal(tmp_path, clock, synchronous="OFF")
    add(journal, 1)
    assert journal.last_seq == 3002
    journal.close()


def test_a_campaign_that_has_not_ended_keeps_its_history(journal: Journal) -> None:
    id = transitions.submit(journal, "a", "", "")
    add(journal, 10)
    transitions.move_campaign(journal, id, "running")
    started = journal.last_seq
    add(journal, 3000)
    assert cut(journal, Retention(events=1000)) == started
    transitions.move_campaign(journal, id, "aborted")
    assert cut(journal, Retention(events=1000)) == journal.last_seq - 999
