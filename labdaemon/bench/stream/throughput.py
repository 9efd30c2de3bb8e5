"""Envelopes of 360 targets: the daemon's publisher against a bare PUB socket that sends the same bytes, in one run."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.publication import publish
from labdaemon.bench.world.row import WorldRow

REPEATS = 3
LEAST_RATIO = 0.5
MOST_CPU_MS = 1.5


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """Rate with many subscribers as a ratio, and CPU an event with one."""
    ratios, rates, size = [], [], 0
    for _ in range(REPEATS):  # in turn, so that a busy machine slows both
        bare = publish("bare", options.events, options.subscribers)
        ours = publish("ours", options.events, options.subscribers)
        ratios.append(bare.took_s / ours.took_s)
        rates.append(ours.events / ours.took_s)
        size = ours.bytes_each
    ratio = statistics.median(ratios)
    result = f"{ratio:.2f} of bare ZeroMQ ({statistics.median(rates):.0f} events/s of {size / 1000:.0f} kB)"
    what = f"{options.subscribers} subscribers, without the disk"
    yield WorldRow("throughput", what, options.events, result, f">= {LEAST_RATIO}", ratio >= LEAST_RATIO)
    alone = [publish("ours", options.events, 1) for _ in range(REPEATS)]
    cpu_ms = 1e3 * statistics.median(one.cpu_s / one.events for one in alone)
    result = f"{cpu_ms:.2f} ms of CPU an event"
    yield WorldRow(
        "throughput", "one subscriber", options.events, result, f"<= {MOST_CPU_MS} ms", cpu_ms <= MOST_CPU_MS
    )
