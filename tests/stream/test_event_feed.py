"""Committed events for servers of other protocols: whoever has seen a `seq` gets what comes after it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import StorageUnavailable
from labdaemon.journal.event import EventText, limit_bytes
from labdaemon.stream import event_feed
from labdaemon.stream.event_feed import KEPT, EventFeed


class CountedOutbox:
    """A journal in memory; counts the reads, and fails when it is to."""

    uuid = "u1"

    def __init__(self, count: int = 0, size: int = 20) -> None:
        self.events = [EventText(seq, "fault", b"x" * size) for seq in range(1, count + 1)]
        self.reads: list[int] = []
        self.error: Exception | None = None
        self._size = size

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def commit(self) -> None:
        self.events.append(EventText(len(self.events) + 1, "fault", b"x" * self._size))

    def history(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        self.reads.append(seq)
        if self.error is not None:
            raise self.error
        return limit_bytes(self.events[seq : seq + limit], most_bytes)

    recent = history

    def latest(self) -> list[EventText]:
        return self.events[-1:]


def run(scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(120.0):
            await scenario()

    asyncio.run(bounded())


def seqs(events: list[EventText]) -> list[int]:
    return [event.seq for event in events]


@settings(max_examples=20, deadline=None, derandomize=True)
@given(count=st.integers(1, 300), seq=st.integers(0, 299))
def test_a_reader_gets_everything_once_and_in_order(count: int, seq: int) -> None:
    outbox = CountedOutbox(count)

    async def scenario() -> None:
        feed, at, got = EventFeed(outbox), min(seq, count - 1), []
        while at < count:
            events = await feed.after(at)
            got += seqs(events)
            at = got[-1]
        assert got == list(range(min(seq, count - 1) + 1, count + 1))
        assert (feed.journal, feed.last_seq) == ("u1", count)

    run(scenario)


def test_who_has_seen_all_waits_for_the_next() -> None:
    outbox = CountedOutbox(3)

    async def scenario() -> None:
        feed = EventFeed(outbox)
        waiting = [asyncio.create_task(feed.after(3)) for _ in range(5)]
        await asyncio.sleep(0.01)
        assert not any(task.done() for task in waiting)
        outbox.commit()
        feed.wake()
        assert [seqs(await task) for task in waiting] == [[4]] * 5

    run(scenario)
    assert len(outbox.reads) == 1, "the journal is read once for all who wait"


def test_readers_who_keep_up_do_not_touch_the_disk() -> None:
    outbox = CountedOutbox(10)

    async def scenario() -> None:
        feed = EventFeed(outbox)
        await feed.after(0)
        for seq in range(1, 10):
            assert seqs(await feed.after(seq))[0] == seq + 1

    run(scenario)
    assert outbox.reads == [0]


def test_what_is_kept_is_bounded_in_number_and_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_feed, "KEPT_BYTES", 5000)

    async def scenario(outbox: CountedOutbox) -> int:
        feed, at = EventFeed(outbox), 0
        while at < outbox.last_seq:
            at = (await feed.after(at))[-1].seq
        return len(feed._kept)

    assert asyncio.run(scenario(CountedOutbox(500, size=1))) == KEPT
    assert asyncio.run(scenario(CountedOutbox(500, size=1000))) == 5
    assert asyncio.run(scenario(CountedOutbox(3, size=100_000))) == 1, "one is kept however large it is"


def test_a_reader_far_behind_is_served_from_the_disk() -> None:
    outbox = CountedOutbox(1000)

    async def scenario() -> None:
        feed = EventFeed(outbox)
        await feed.after(950)
        assert seqs(await feed.after(10))[0] == 11
        assert seqs(await feed.after(960))[0] == 961

    run(scenario)


def test_a_disk_that_does_not_answer_is_the_readers_to_wait_for() -> None:
    outbox = CountedOutbox(3)

    async def scenario() -> None:
        feed = EventFeed(outbox)
        outbox.error = StorageUnavailable("the disk does not answer")
        with pytest.raises(StorageUnavailable):
            await feed.after(0)
        outbox.error = None
        assert seqs(await feed.after(0)) == [1, 2, 3]

    run(scenario)
