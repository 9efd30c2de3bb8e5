"""Envelopes of 360 targets: the daemon's publisher against a bare PUB socket that sends the same bytes, in one run."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import replace

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.publication import publish
from labdaemon.bench.world.row import WorldRow

REPEATS = 3
LEAST_RATIO = 0.5
MOST_CPU_MS = 1.5


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """Rate with many subscribers as a ratio, without and with keys, and CPU an event with one."""
    without_s, row = _against_bare(options, has_keys=False)
    yield row
    with_s, row = _against_bare(options, has_keys=True)
    share = f"; {without_s / with_s:.2f} of the rate without keys"
    yield replace(row, result=row.result + share)
    alone = [publish("ours", options.events, 1) for _ in range(REPEATS)]
    cpu_ms = 1e3 * statistics.median(one.cpu_s / one.events for one in alone)
    result = f"{cpu_ms:.2f} ms of CPU an event"
    yield WorldRow(
        "throughput", "one subscriber", options.events, result, f"<= {MOST_CPU_MS} ms", cpu_ms <= MOST_CPU_MS
    )


def _against_bare(options: StreamOptions, *, has_keys: bool) -> tuple[float, WorldRow]:
    """Seconds that our publication took (median), and the row."""
    ratios, times, events, size = [], [], 0, 0
    for _ in range(REPEATS):  # in turn, so that a busy machine slows both
        bare = publish("bare", options.events, options.subscribers, has_keys=has_keys)
        ours = publish("ours", options.events, options.subscribers, has_keys=has_keys)
        ratios.append(bare.took_s / ours.took_s)
        times.append(ours.took_s)
        events, size = ours.events, ours.bytes_each
    ratio, took_s = statistics.median(ratios), statistics.median(times)
    encrypted = "encrypted " if has_keys else ""
    result = f"{ratio:.2f} of bare {encrypted}ZeroMQ ({events / took_s:.0f} events/s of {size / 1000:.0f} kB)"
    what = f"{options.subscribers} subscribers{' with keys' * has_keys}, without the disk"
    return took_s, WorldRow("throughput", what, options.events, result, f">= {LEAST_RATIO}", ratio >= LEAST_RATIO)
