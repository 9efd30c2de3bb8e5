"""What the journal knows of the cameras' cards: files that are accounted for, files still to come, and their clocks.

A file on a card is known by handle, name, time and size together, for as long as it is there: bodies use names and
handles again, and some have no clock, so what was deleted is forgotten.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from labdaemon.journal.journal import Journal, Transaction

ANY_HANDLE = ANY_SIZE = -1
"""Of files that a journal of version 0.1.0 knew by name and time alone."""


class CardIdentity(NamedTuple):
    """What one file on a card is known by."""

    name: str
    captured_at: str
    handle: int = ANY_HANDLE
    size_bytes: int = ANY_SIZE

    def resembles(self, other: CardIdentity) -> bool:
        """Whether both may be one file under two handles: handles are new in each session of some bodies."""
        sizes = {self.size_bytes, other.size_bytes} - {ANY_SIZE}
        return (self.name, self.captured_at) == (other.name, other.captured_at) and len(sizes) < 2


@dataclass(frozen=True, slots=True)
class OwedFile:
    """A file that a camera has not delivered for an opening of its shutter.

    Attributes
    ----------
    opened_at
        Wall-clock time of the opening, or of the intention to open, RFC 3339.
    """

    camera: str
    campaign: str
    capture: str
    opened_at: str
    exposure_s: float


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """A camera's clock against the host's wall clock.

    Attributes
    ----------
    offset_s
        The camera's time stamp minus the opening's time, seconds; zones and all.
    sd_s
        Its standard deviation: bodies write whole seconds.
    exposure_s
        Of the frame that it was taken from; a body may stamp the opening or its end.
    measured_at
        Wall-clock time of that opening, RFC 3339.
    """

    camera: str
    offset_s: float
    sd_s: float
    exposure_s: float
    measured_at: str


def is_accounted(journal: Journal, camera: str, file: CardIdentity) -> bool:
    """Whether this file on a card was copied, or is none of ours."""
    rows = journal.read(
        "SELECT 1 FROM card_files WHERE camera = ? AND card_name = ? AND captured_at = ? "
        "AND ((handle = ? AND size_bytes = ?) OR (handle = ? AND size_bytes IN (?, ?))) LIMIT 1",
        camera,
        file.name,
        file.captured_at,
        file.handle,
        file.size_bytes,
        ANY_HANDLE,
        ANY_SIZE,
        file.size_bytes,
    )
    return bool(rows)


def card_files(journal: Journal, camera: str) -> dict[CardIdentity, bool]:
    """Files of a card that are accounted for; the value says whether a copy of ours is on disk."""
    rows = journal.read(
        "SELECT card_name, captured_at, handle, size_bytes, is_copied FROM card_files WHERE camera = ?", camera
    )
    return {CardIdentity(*row[:4]): bool(row[4]) for row in rows}


def owed_files(journal: Journal, camera: str) -> list[OwedFile]:
    """Files that this camera has not delivered, oldest first."""
    rows = journal.read(
        "SELECT camera, campaign, capture, opened_at, exposure_s FROM owed_files WHERE camera = ? ORDER BY opened_at",
        camera,
    )
    return [OwedFile(*row) for row in rows]


def clock_offsets(journal: Journal) -> dict[str, ClockOffset]:
    """The latest offset of each camera's clock."""
    rows = journal.read("SELECT camera, offset_s, sd_s, exposure_s, measured_at FROM camera_clocks")
    return {row[0]: ClockOffset(*row) for row in rows}


def account_files(journal: Journal, camera: str, files: Iterable[CardIdentity]) -> None:
    """Note files on a camera's card that are none of ours: they are left alone."""
    with journal.transaction("card.known") as write:
        for file in files:
            add_card_file(write, camera, file, is_copied=False)


def forget_files(journal: Journal, camera: str, files: Iterable[CardIdentity]) -> None:
    """Files are no longer on the card: their names and handles may come again for others."""
    with journal.transaction("card.forgotten") as write:
        for file in files:
            _remove(write, camera, file)


def rename_handles(journal: Journal, camera: str, pairs: Iterable[tuple[CardIdentity, CardIdentity]]) -> None:
    """Files that are accounted for have other handles in a new session: (before, now) each."""
    with journal.transaction("card.renamed") as write:
        for before, now in pairs:
            copied = write.execute(
                "SELECT is_copied FROM card_files WHERE camera = ? AND card_name = ? AND captured_at = ? "
                "AND handle = ? AND size_bytes = ?", camera, *before
            ).fetchone()  # fmt: skip
            _remove(write, camera, before)
            add_card_file(write, camera, now, is_copied=bool(copied and copied[0]))


def forget_owed(journal: Journal, camera: str, owed: Iterable[OwedFile]) -> None:
    """Files that will not come any more."""
    with journal.transaction("card.written_off") as write:
        for file in owed:
            write.execute(
                "DELETE FROM owed_files WHERE camera = ? AND campaign = ? AND capture = ?",
                camera,
                file.campaign,
                file.capture,
            )


def add_card_file(write: Transaction, camera: str, file: CardIdentity, *, is_copied: bool) -> None:
    """Account for a file within a transaction."""
    write.execute(
        "INSERT OR REPLACE INTO card_files (camera, card_name, captured_at, handle, size_bytes, is_copied) "
        "VALUES (?, ?, ?, ?, ?, ?)",
        camera,
        *file,
        int(is_copied),
    )


def keep_offsets(write: Transaction, offsets: Iterable[ClockOffset]) -> None:
    """Replace the clocks' offsets within a transaction."""
    for offset in offsets:
        write.execute(
            "INSERT OR REPLACE INTO camera_clocks (camera, offset_s, sd_s, exposure_s, measured_at) "
            "VALUES (?, ?, ?, ?, ?)",
            offset.camera,
            offset.offset_s,
            offset.sd_s,
            offset.exposure_s,
            offset.measured_at,
        )


def _remove(write: Transaction, camera: str, file: CardIdentity) -> None:
    write.execute(
        "DELETE FROM card_files WHERE camera = ? AND card_name = ? AND captured_at = ? AND handle = ? "
        "AND size_bytes = ?",
        camera,
        *file,
    )
