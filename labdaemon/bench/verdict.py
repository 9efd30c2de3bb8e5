"""What a data folder must look like after a campaign that was killed again and again."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections import Counter
from dataclasses import dataclass, fields
from pathlib import Path

from labdaemon.durable import PART
from labdaemon.file_hash import sha256_of


@dataclass(frozen=True, slots=True)
class CampaignVerdict:
    """Counts of what must not be. All zero is well.

    Attributes
    ----------
    frames_lost
        Frames that the cameras took and that are neither on disk, whole, nor on a card.
    results_repeated, results_missing
        Steps with more, or fewer, than one envelope, in the journal or in `envelope.csv`.
    stray_parts
        Files that end in ``.part``.
    seq_gaps
        Places where `seq` does not rise by one.
    open_ends
        Campaigns that did not complete, and captures left neither stored nor given up.
    """

    frames_lost: int = 0
    results_repeated: int = 0
    results_missing: int = 0
    stray_parts: int = 0
    seq_gaps: int = 0
    open_ends: int = 0

    @property
    def is_well(self) -> bool:
        """Nothing of it."""
        return not any(getattr(self, field.name) for field in fields(self))

    def __add__(self, other: CampaignVerdict) -> CampaignVerdict:
        return CampaignVerdict(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))


def judge(data: Path, *, taken: int, on_cards: int, captures: int, has_files: bool = True) -> CampaignVerdict:
    """Look at a data folder whose daemon has ended.

    Parameters
    ----------
    taken
        Frames that the cameras took in all.
    on_cards
        Of them, still on cards.
    captures
        Steps that must have one envelope each.
    has_files
        Whether result files were written, and must agree.
    """
    with sqlite3.connect(f"file:{data / 'journal.db'}?mode=ro", uri=True) as journal:
        seqs = [row[0] for row in journal.execute("SELECT seq FROM events ORDER BY seq")]
        kept = journal.execute("SELECT path, size_bytes, sha256 FROM frames").fetchall()
        published = [
            (campaign, json.loads(data)["step"])
            for campaign, data in journal.execute("SELECT campaign, data FROM events WHERE kind = 'envelope'")
        ]
        ends = journal.execute("SELECT count(*) FROM campaigns WHERE state <> 'completed'").fetchone()[0]
        ends += journal.execute(
            "SELECT count(*) FROM captures WHERE state IN ('intended', 'fired', 'exposed')"
        ).fetchone()[0]
    journal.close()
    whole = sum((data / path).is_file() and sha256_of(data / path) == sha256 for path, _, sha256 in kept)
    a_step = Counter(published)
    a_file = _captures_in(data)
    return CampaignVerdict(
        frames_lost=max(taken - whole - on_cards, 0),
        results_repeated=sum(count - 1 for count in a_step.values()) + sum(count - 1 for count in a_file.values()),
        results_missing=captures - len(a_step) + (captures - len(a_file) if has_files else 0),
        stray_parts=sum(1 for _ in data.rglob(f"*{PART}")),
        seq_gaps=sum(later - earlier != 1 for earlier, later in zip([0, *seqs], seqs, strict=False)),
        open_ends=int(ends),
    )


def _captures_in(data: Path) -> Counter[tuple[str, str]]:
    """How often each capture has rows of its own in the result files: rows of one capture stand together."""
    seen: Counter[tuple[str, str]] = Counter()
    for path in data.glob("campaigns/*/results/envelope.csv"):
        with path.open(newline="") as file:
            rows = Counter((row["capture"], row["target"]) for row in csv.DictReader(file))
        for (capture, _), count in rows.items():
            place = (path.parents[1].name, capture)
            seen[place] = max(seen[place], count)
    return seen
