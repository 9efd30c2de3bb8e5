"""What the journal knows of the cameras' cards."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.journal import card_records
from labdaemon.journal.card_records import ANY_HANDLE, ANY_SIZE, CardIdentity, ClockOffset
from labdaemon.journal.journal import Journal

FILE = CardIdentity("DSC_0001.NEF", "20190101T000000", 17, 1000)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


@pytest.mark.parametrize(("other", "resembles"), [
    (FILE._replace(handle=99), True),
    (FILE._replace(size_bytes=ANY_SIZE), True),
    (FILE._replace(size_bytes=1001), False),
    (FILE._replace(name="DSC_0002.NEF"), False),
    (FILE._replace(captured_at="20190101T000001"), False),
])  # fmt: skip
def test_a_file_is_known_again_under_another_handle(other: CardIdentity, resembles: bool) -> None:
    assert FILE.resembles(other) is resembles
    assert other.resembles(FILE) is resembles


def test_a_file_is_accounted_for_by_all_it_is_known_by(journal: Journal) -> None:
    card_records.account_files(journal, "left", [FILE])
    assert card_records.is_accounted(journal, "left", FILE)
    assert not card_records.is_accounted(journal, "right", FILE)
    for other in (FILE._replace(handle=18), FILE._replace(size_bytes=1), FILE._replace(captured_at="")):
        assert not card_records.is_accounted(journal, "left", other), "bodies use names and handles again"
    assert card_records.card_files(journal, "left") == {FILE: False}


@pytest.mark.parametrize("known", [
    FILE._replace(handle=ANY_HANDLE, size_bytes=ANY_SIZE), FILE._replace(handle=ANY_HANDLE),
])  # fmt: skip
def test_what_an_earlier_version_knew_by_name_counts(journal: Journal, known: CardIdentity) -> None:
    card_records.account_files(journal, "left", [known])
    assert card_records.is_accounted(journal, "left", FILE)


def test_a_forgotten_file_may_come_again(journal: Journal) -> None:
    card_records.account_files(journal, "left", [FILE, FILE._replace(handle=18)])
    card_records.forget_files(journal, "left", [FILE])
    assert not card_records.is_accounted(journal, "left", FILE)
    assert card_records.is_accounted(journal, "left", FILE._replace(handle=18))


def test_new_handles_keep_what_was_known_of_the_copy(journal: Journal) -> None:
    with journal.transaction("copied") as write:
        card_records.add_card_file(write, "left", FILE, is_copied=True)
    now = FILE._replace(handle=40)
    card_records.rename_handles(journal, "left", [(FILE, now)])
    assert card_records.card_files(journal, "left") == {now: True}


def test_the_latest_offset_of_each_clock_is_kept(journal: Journal) -> None:
    old = ClockOffset("left", -3600.0, 0.3, 1.0, "2026-05-04T10:00:00.000000Z")
    new = ClockOffset("left", -3601.0, 0.3, 1.0, "2026-05-04T11:00:00.000000Z")
    other = ClockOffset("right", 2.0, 0.3, 0.5, "2026-05-04T10:30:00.000000Z")
    for offset in (old, other, new):
        with journal.transaction("offset") as write:
            card_records.keep_offsets(write, [offset])
    assert card_records.clock_offsets(journal) == {"left": new, "right": other}
