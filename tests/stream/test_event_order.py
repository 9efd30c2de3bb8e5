"""The order of events as a model: whatever is lost, repeated or cut, each event that there is comes once, in order."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.stream.client_errors import HistoryCut, JournalChanged
from labdaemon.stream.event_order import EventOrder

A, B = "a", "b"


def event(seq: int, journal: str = A) -> dict[str, Any]:
    return {"kind": "fault", "seq": seq, "journal": journal}


def status(seq: int, journal: str = A) -> dict[str, Any]:
    return {"kind": "status", "seq": seq, "journal": journal}


def answer(seqs: range, **about: Any) -> dict[str, Any]:
    return {"events": [event(seq) for seq in seqs], "journal": A, **about}


def drained(order: EventOrder) -> list[int]:
    found = []
    while (message := order.pop()) is not None:
        if message["kind"] != "status":
            found.append(message["seq"])
    return found


@given(st.lists(st.tuples(st.integers(1, 30), st.booleans()), max_size=40), st.integers(0, 5), st.integers(1, 7))
def test_each_event_comes_once_and_in_order(seen: list[tuple[int, bool]], after: int, at_a_time: int) -> None:
    """Messages arrive in any order and number; replay has them all, a few at a time."""
    order, delivered, newest = EventOrder(after), [], after
    for seq, is_status in seen:
        message = status(seq) if is_status else event(seq)
        newest = max(newest, seq)
        missing = order.missing(message)
        if missing is not None:
            done, last = missing
            while done < last:
                replayed = range(done + 1, min(done + at_a_time, last) + 1)
                done = order.add_replayed(answer(replayed), done) or last
        order.add(message)
        delivered += drained(order)
    assert delivered == list(range(after + 1, newest + 1))


def test_from_now_on_begins_with_the_first_message() -> None:
    order = EventOrder()
    assert order.missing(status(7)) is None
    assert order.missing(event(8)) is None
    order.add(event(8))
    assert (drained(order), order.last) == ([8], 8)


def test_another_journal_is_said_once_and_followed_from_its_beginning() -> None:
    order = EventOrder(5, A)
    with pytest.raises(JournalChanged) as changed:
        order.missing(status(2, B))
    assert (changed.value.before, changed.value.now) == (A, B)
    assert order.missing(status(2, B)) == (0, 2)
    assert order.add_replayed({"events": [event(1, B), event(2, B)], "journal": B}, 0) == 2
    assert drained(order) == [1, 2]


def test_cut_history_is_said_once_and_the_rest_follows() -> None:
    order = EventOrder(0, A)
    assert order.missing(event(50)) == (0, 49)
    with pytest.raises(HistoryCut, match="events 1 to 40 are no longer kept") as cut:
        order.add_replayed(answer(range(41, 44), gone_before=41), 0)
    assert (cut.value.after, cut.value.gone_before) == (0, 41)
    assert order.missing(event(50)) == (40, 49)
    order.add_replayed(answer(range(41, 50), gone_before=41), 40)  # which says nothing new
    order.add(event(50))
    assert drained(order) == list(range(41, 51))


def test_an_answer_of_another_journal_fills_no_gap() -> None:
    order = EventOrder(0, A)
    order.missing(status(3))
    assert order.add_replayed({"events": [event(1, B)], "journal": B}, 0) is None
    assert drained(order) == []
