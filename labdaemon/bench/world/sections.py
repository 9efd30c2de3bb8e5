"""The sections of `labdaemon bench world`: a name, and the module whose ``rows(options)`` yields its rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module

from labdaemon.bench.world.row import WorldOptions, WorldRow

SECTIONS = {
    "endings": "labdaemon.bench.world.endings",
    "fuzz": "labdaemon.bench.world.fuzz",
    "messages": "labdaemon.bench.world.messages",
    "stopping": "labdaemon.bench.world.stopping",
    "false trips": "labdaemon.bench.world.false_trips",
    "disk": "labdaemon.bench.world.disk",
}
"""In the order of the table. Modules are imported when their section runs."""


def section(name: str) -> Callable[[WorldOptions], Iterator[WorldRow]]:
    """The function that runs a section."""
    found: Callable[[WorldOptions], Iterator[WorldRow]] = import_module(SECTIONS[name]).rows
    return found
