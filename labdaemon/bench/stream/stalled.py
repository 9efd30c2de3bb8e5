"""Subscribers that never read: what they cost the publisher in memory, and the others in time."""

from __future__ import annotations

from collections.abc import Iterator

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.publication import publish
from labdaemon.bench.world.row import WorldRow
from labdaemon.stream.sockets import EVENTS_HIGH_WATER

STALLED = 5
READING = 3
SLACK = 1.3
MOST_SLOWER = 1.5
ROUNDS = 8
"""Together more than the high-water mark."""


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """Memory and time with and without them, open and with keys."""
    for has_keys in (False, True):
        without = publish("ours", options.events, READING, rounds=ROUNDS, has_keys=has_keys)
        with_them = publish("ours", options.events, READING, stalled=STALLED, rounds=ROUNDS, has_keys=has_keys)
        slower = with_them.took_s / without.took_s
        grown_mb = with_them.memory_mb - without.memory_mb
        queue_mb = EVENTS_HIGH_WATER * with_them.bytes_each / (1 << 20)
        result = f"{slower:.2f} times as long, {grown_mb:.0f} MB more"
        goal = f"<= {MOST_SLOWER:g} times, one queue of {EVENTS_HIGH_WATER} events for all of them: {queue_mb:.0f} MB"
        what = f"{STALLED} subscribers that never read, {READING} that do{', with keys' * has_keys}"
        holds = slower <= MOST_SLOWER and grown_mb <= SLACK * queue_mb
        yield WorldRow("stalled", what, with_them.events, result, goal, holds)
