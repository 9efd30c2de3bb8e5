"""What all sections of `labdaemon bench stream` are given, and where they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module

from labdaemon.bench.world.row import WorldRow


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """How a person started it.

    Attributes
    ----------
    events
        Envelopes of a throughput measurement.
    subscribers
        That receive them.
    captures
        Commands of each way in whose latency is measured.
    messages
        Hostile messages.
    seed
        Of what is random.
    """

    events: int = 200
    subscribers: int = 20
    captures: int = 30
    messages: int = 20_000
    seed: int = 1


SECTIONS = {
    "throughput": "labdaemon.bench.stream.throughput",
    "stalled": "labdaemon.bench.stream.stalled",
    "joiners": "labdaemon.bench.stream.joiners",
    "latency": "labdaemon.bench.stream.latency",
    "hostile": "labdaemon.bench.stream.hostile",
}
"""Section -> the module whose ``rows(options)`` yields its rows; imported when it runs."""


def section(name: str) -> Callable[[StreamOptions], Iterator[WorldRow]]:
    """The function that runs a section."""
    found: Callable[[StreamOptions], Iterator[WorldRow]] = import_module(SECTIONS[name]).rows
    return found
