"""Misbehaviour on demand: each simulator has one table of faults by name, switched on from outside.

A fault may be given a count (so many times, then well again) and a value whose meaning the table states.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(slots=True)
class ActiveFault:
    """A fault that is on: how often it still strikes (None: until cleared) and its value."""

    left: int | None
    value: float | None


class Faults:
    """The switches of one simulator.

    Parameters
    ----------
    table
        Name -> what it does, the value's meaning included.
    """

    def __init__(self, table: Mapping[str, str]) -> None:
        self.table = dict(table)
        self._active: dict[str, ActiveFault] = {}
        self._lock = threading.Lock()

    def inject(self, name: str, *, count: int | None = None, value: float | None = None) -> None:
        """Switch a fault on; raises `KeyError` with the known names for one that is not in the table."""
        if name not in self.table:
            raise KeyError(f"no fault {name!r}; there are {', '.join(sorted(self.table))}")
        with self._lock:
            self._active[name] = ActiveFault(count, value)

    def clear(self, name: str | None = None) -> None:
        """Switch one fault off, or all."""
        with self._lock:
            if name is None:
                self._active.clear()
            else:
                self._active.pop(name, None)

    def strike(self, name: str) -> bool:
        """Whether the fault is on now; uses up one of its count."""
        assert name in self.table, name
        with self._lock:
            fault = self._active.get(name)
            if fault is None:
                return False
            if fault.left is not None:
                fault.left -= 1
                if fault.left <= 0:
                    del self._active[name]
            return True

    def is_on(self, name: str) -> bool:
        """Whether the fault is on, without using it up."""
        assert name in self.table, name
        with self._lock:
            return name in self._active

    def value(self, name: str, default: float) -> float:
        """The value that a fault was given, while it is on."""
        with self._lock:
            fault = self._active.get(name)
            return default if fault is None or fault.value is None else fault.value
