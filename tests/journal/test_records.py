"""Rows of the journal as values: what each query finds, and in which order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.events import CaptureData, EnvelopeData, StepData
from labdaemon.journal import records, transitions
from labdaemon.journal.card_records import CardIdentity
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import NO_STEP, CaptureRecord, FrameRecord

CAPTURE = CaptureRecord(
    "c", "a-01", 3, 0, "a", False, "s1", None, "intended", 5.0, 1.0, 0.5, None, {}, None, None, ("left", "right"), {},
    None,
)  # fmt: skip


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


def begin(journal: Journal, *captures: CaptureRecord) -> None:
    for capture in captures:
        transitions.intend_capture(journal, capture)


def finish(journal: Journal, capture: CaptureRecord, opened_at: str = "2026-05-04T10:00:00.000000Z") -> None:
    transitions.fire_capture(
        journal, capture.campaign, capture.name, opened_at=opened_at, opening_s={}, phase_rad=None, sd_phase_rad=None
    )
    transitions.complete_capture(journal, capture.campaign, CaptureData(capture=capture.name))


def frame(capture: str, camera: str, card_name: str = "DSC_0001.NEF", size_bytes: int = 10) -> FrameRecord:
    path = f"c/{capture}/{camera}.nef"
    return FrameRecord("c", capture, camera, path, card_name, "20190101T000000", size_bytes, "ab" * 32, "stored")


def test_a_capture_comes_back_as_it_was_intended(journal: Journal) -> None:
    begin(journal, CAPTURE)
    assert records.captures(journal) == [CAPTURE]


def test_openings_and_files_come_back_by_camera(journal: Journal) -> None:
    begin(journal, CAPTURE)
    transitions.fire_capture(
        journal, "c", "a-01", opened_at="t", opening_s={"left": 0.01, "right": 0.02}, phase_rad=1.5, sd_phase_rad=0.1
    )
    files = {"left": CardIdentity("DSC_1", "t", 4, 100)}
    transitions.expose_capture(journal, "c", "a-01", files)
    [capture] = records.captures(journal, "c", "exposed")
    assert capture.opening_s == {"left": 0.01, "right": 0.02}
    assert (capture.phase_rad, capture.sd_phase_rad, capture.files) == (1.5, 0.1, files)


def test_captures_are_found_by_campaign_state_and_step(journal: Journal) -> None:
    other, later = replace(CAPTURE, campaign="d"), replace(CAPTURE, name="b-01", step=4)
    begin(journal, later, CAPTURE, other)
    transitions.discard_capture(journal, "c", "b-01", "interrupted", {})
    assert [one.name for one in records.captures(journal, "c")] == ["a-01", "b-01"]
    assert [one.campaign for one in records.captures(journal)] == ["c", "c", "d"]
    assert records.captures(journal, "c", "discarded")[0].reason == "interrupted"
    assert records.captures(journal, "c", step=3) == [CAPTURE]
    assert records.captures(journal, "c", "intended", "discarded", step=4)[0].name == "b-01"
    assert records.captures(journal, "e") == []


def test_shots_are_counted_whatever_became_of_them(journal: Journal) -> None:
    begin(journal, CAPTURE, replace(CAPTURE, name="a-01-r2"), replace(CAPTURE, name="a-02", shot=1))
    transitions.discard_capture(journal, "c", "a-01", "interrupted", {})
    assert [records.count_shots(journal, "c", 3, shot) for shot in (0, 1, 2)] == [2, 1, 0]


def test_names_of_captures_and_groups_are_taken(journal: Journal) -> None:
    begin(journal, replace(CAPTURE, grouped="planned"), replace(CAPTURE, name="m", step=NO_STEP, grouped="bolt"))
    assert [records.has_capture(journal, "c", name) for name in ("a-01", "planned", "bolt", "x")] == [
        True, True, True, False,
    ]  # fmt: skip
    assert records.is_taken(journal, "c", "planned")
    assert not records.is_taken(journal, "c", "bolt"), "a manual group takes further members"
    assert records.manual_count(journal, "c") == 1


def test_the_latest_sharp_set_is_the_newest_that_is_stored(journal: Journal) -> None:
    old, new, unfinished = (
        replace(CAPTURE, name=name, is_sharp=True, sharp=name) for name in ("s-old", "s-new", "s-unfinished")
    )
    assert records.latest_sharp(journal, "c") is None
    begin(journal, new, old, unfinished)
    finish(journal, new, "2026-05-04T11:00:00.000000Z")
    finish(journal, old, "2026-05-04T10:00:00.000000Z")
    latest = records.latest_sharp(journal, "c")
    assert latest is not None
    assert latest.name == "s-new"


def test_a_manual_group_has_its_stored_members_by_name(journal: Journal) -> None:
    members = [replace(CAPTURE, name=f"m{number}", step=NO_STEP, grouped="bolt") for number in (2, 1, 3)]
    begin(journal, *members)
    for member in members[:2]:
        finish(journal, member)
    assert [one.name for one in records.group_members(journal, "c", "bolt")] == ["m1", "m2"]


def test_a_file_of_a_card_leads_to_the_frame_it_was_copied_to_last(journal: Journal) -> None:
    first, second = frame("a-01", "left"), frame("a-02", "left")
    for one in (first, second, frame("a-02", "right")):
        transitions.store_frame(journal, one)
    identity = CardIdentity("DSC_0001.NEF", "20190101T000000", 7, 10)
    assert records.frame_of_card(journal, "left", identity) == second
    assert records.frame_of_card(journal, "left", identity._replace(size_bytes=11)) is None
    assert records.frames(journal, "c", "a-02") == [second, frame("a-02", "right")]


def test_results_come_in_the_order_of_measuring_and_a_replaced_one_last(journal: Journal) -> None:
    names = [f"n{number:02d}" for number in range(records.RESULTS_AT_A_TIME + 5)]
    for name in reversed(names):
        row = {"target": "T01", "ax_mm": 0.5}
        transitions.record_result(
            journal, "c", [], envelope=[row], measurements=[row | {"camera": "left"}], event=EnvelopeData(capture=name)
        )
    assert [one.name for one in records.results(journal, "c")] == names[::-1]
    transitions.record_result(
        journal, "c", [], envelope=[], measurements=[], event=EnvelopeData(capture=names[3]), replace=True
    )
    found = list(records.results(journal, "c"))
    assert (found[-1].name, found[-1].envelope, len(found)) == (names[3], [], len(names))
    assert found[0].measurements == [{"target": "T01", "ax_mm": 0.5, "camera": "left"}]
    assert records.result_names(journal, "c") == set(names)


def test_steps_count_their_attempts(journal: Journal) -> None:
    for attempt in (1, 2):
        assert transitions.start_step(journal, "c", StepData(step=4)) == attempt
    transitions.end_step(journal, "c", StepData(step=4))
    found = records.step(journal, "c", 4)
    assert found is not None
    assert (found.state, found.attempts) == ("completed", 2)
    assert set(records.steps(journal, "c")) == {4}
    assert records.step(journal, "c", 5) is None


def test_stored_captures_are_counted_by_step(journal: Journal) -> None:
    manual = replace(CAPTURE, name="m", step=NO_STEP)
    begin(journal, CAPTURE, manual, replace(CAPTURE, name="a-02"))
    finish(journal, CAPTURE)
    finish(journal, manual)
    assert records.captures_by_step(journal, "c") == {3: 1, NO_STEP: 1}


def test_campaigns_come_in_the_order_of_submission(journal: Journal) -> None:
    ids = [transitions.submit(journal, name, "", "") for name in ("b", "a", "c")]
    transitions.move_campaign(journal, ids[1], "running")
    assert [one.id for one in records.campaigns(journal)] == ids
    assert [one.id for one in records.campaigns(journal, "queued", limit=1)] == ids[:1]
    assert [records.count_campaigns(journal, state) for state in ("queued", "running", "failed")] == [2, 1, 0]
    assert records.campaign(journal, "0009-x") is None


def test_a_stamp_is_kept_for_each_campaign(journal: Journal) -> None:
    transitions.keep_stamp(journal, "c", "one")
    transitions.keep_stamp(journal, "c", "two")
    assert (records.stamp_of(journal, "c"), records.stamp_of(journal, "d")) == ("two", None)
