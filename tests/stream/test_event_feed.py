"""Events for servers of other protocols: in order, each once, the journal read once for all."""

from __future__ import annotations

import asyncio

import pytest

from labdaemon.errors import StorageUnavailable
from labdaemon.journal.event import EventText
from labdaemon.stream import event_feed
from labdaemon.stream.event_feed import KEPT, EventFeed
from labdaemon.testing.served import FakeOutbox


class CountedOutbox(FakeOutbox):
    """Counts how often it is read."""

    reads = 0
    refuses = False

    def history(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        self.reads += 1
        if self.refuses:
            raise StorageUnavailable("the disk is away")
        return super().recent(seq, limit, most_bytes)


@pytest.fixture
def outbox() -> CountedOutbox:
    return CountedOutbox()


async def take(feed: EventFeed, seq: int, count: int) -> list[int]:
    found: list[int] = []
    while len(found) < count:
        found += [event.seq for event in await feed.after(found[-1] if found else seq)]
    return found


async def test_who_waits_is_woken_and_the_journal_is_read_once(outbox: CountedOutbox):
    feed = EventFeed(outbox)
    waiting = [asyncio.create_task(take(feed, 0, 3)) for _ in range(20)]
    await asyncio.sleep(0)
    for place in range(3):
        outbox.add("fault", message=str(place))
    feed.wake()
    assert await asyncio.gather(*waiting) == [[1, 2, 3]] * 20
    assert outbox.reads == 1


async def test_who_is_far_behind_disturbs_no_one(outbox: CountedOutbox, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(event_feed, "BATCH", 50)
    for place in range(500):
        outbox.add("fault", message=str(place))
    feed = EventFeed(outbox)
    assert await take(feed, 490, 10) == list(range(491, 501))
    assert await take(feed, 0, 500) == list(range(1, 501))
    before = outbox.reads
    assert await take(feed, 495, 5) == list(range(496, 501))
    assert outbox.reads == before
    assert len(feed._kept) <= KEPT


async def test_memory_is_bounded_by_bytes_too(outbox: CountedOutbox, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(event_feed, "KEPT_BYTES", 1000)
    for _ in range(20):
        outbox.add("envelope", targets=["x" * 400])
    feed = EventFeed(outbox)
    assert await take(feed, 0, 20) == list(range(1, 21))
    assert sum(len(event.json) for event in feed._kept) <= 1000


async def test_a_disk_that_is_away_is_the_waiters_affair(outbox: CountedOutbox):
    outbox.add("fault", message="x")
    outbox.refuses = True
    feed = EventFeed(outbox)
    with pytest.raises(StorageUnavailable):
        await feed.after(0)
    outbox.refuses = False
    assert await take(feed, 0, 1) == [1]


async def test_a_wait_that_is_given_up_leaves_nothing(outbox: CountedOutbox):
    feed = EventFeed(outbox)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await feed.after(5)
    outbox.add("fault", message="x")
    feed.wake()
    assert await take(feed, 0, 1) == [1]
