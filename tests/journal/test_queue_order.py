"""The order of the queue: that of submission until a person moves one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labdaemon.clock import SimulatedClock
from labdaemon.journal import queue_order, transitions
from labdaemon.journal.journal import Journal


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


def submitted(journal: Journal, *names: str) -> list[str]:
    return [transitions.submit(journal, name, "", "") for name in names]


def test_first_come_first_served(journal: Journal) -> None:
    ids = submitted(journal, "a", "b", "c")
    assert queue_order.queued(journal) == ids


def test_a_campaign_moves_and_later_ones_still_come_later(journal: Journal) -> None:
    a, b, c = submitted(journal, "a", "b", "c")
    assert queue_order.place_campaign(journal, c, 0) == [c, a, b]
    [d] = submitted(journal, "d")
    assert queue_order.queued(journal) == [c, a, b, d]
    assert queue_order.place_campaign(journal, a, 99) == [c, b, d, a]
    transitions.move_campaign(journal, c, "running")
    assert queue_order.queued(journal) == [b, d, a]


def test_what_does_not_wait_is_not_moved(journal: Journal) -> None:
    a, b = submitted(journal, "a", "b")
    transitions.move_campaign(journal, a, "running")
    assert queue_order.place_campaign(journal, a, 0) is None
    assert queue_order.place_campaign(journal, "none", 0) is None
    assert queue_order.queued(journal) == [b]


def test_the_order_is_kept_over_a_restart(tmp_path: Path) -> None:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    a, b = submitted(journal, "a", "b")
    queue_order.place_campaign(journal, b, 0)
    journal.close()
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    assert queue_order.queued(journal) == [b, a]
    journal.close()


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 7)), max_size=8))
def test_it_is_a_list_with_insert(journal: Journal, moves: list[tuple[int, int]]) -> None:
    if not queue_order.queued(journal):
        submitted(journal, *"abcdef")
    order = queue_order.queued(journal)
    for which, place in moves:
        id = order.pop(which)
        order.insert(place, id)
        assert queue_order.place_campaign(journal, id, place) == order
    assert queue_order.queued(journal) == order
