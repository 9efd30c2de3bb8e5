"""A row of the table that `labdaemon bench world` prints, and what all sections are given."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

HEADS = ("section", "what", "tries", "result", "goal", "holds")


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """How a person started it.

    Attributes
    ----------
    quick
        A few tries of each kind, for a look in a minute or two.
    seed
        Of random moments and mutations.
    soak_minutes
        How long a section that waits for something not to happen does so.
    """

    quick: bool = False
    seed: int = 1
    soak_minutes: float = 30.0


@dataclass(frozen=True, slots=True)
class WorldRow:
    """What one kind of trouble came to.

    Attributes
    ----------
    section
        Name of the section.
    what
        The trouble.
    tries
        How often it was tried.
    result, goal
        What was seen, and what must be reached, as a person reads it: ``0.31 s``, ``<= 2 s``.
    holds
        Whether the goal was reached.
    """

    section: str
    what: str
    tries: int
    result: str
    goal: str
    holds: bool

    def as_json(self) -> dict[str, Any]:
        """The row as a JSON object."""
        return asdict(self)


def table_of(rows: Iterable[WorldRow]) -> str:
    """The table in Markdown, as the README quotes it."""
    lines = [f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
    for row in rows:
        cells = (row.section, row.what, str(row.tries), row.result, row.goal, "yes" if row.holds else "NO")
        lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines)
