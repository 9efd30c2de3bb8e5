"""Each change of state is one transaction with the event that reports it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.events import CampaignData, EnvelopeData, FaultData, StepData, TargetRow
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CampaignState
from labdaemon.journal.transitions import WAYS_TO


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


def last(journal: Journal) -> tuple[str, dict[str, object]]:
    event = journal.events_after(journal.last_seq - 1, 1)[0]
    return event.kind, event.data


@pytest.mark.parametrize(("name", "expected"), [
    ("Night 1", "0001-night-1"), ("Brücke / Süd", "0001-br-cke-s-d"), ("//", "0001-campaign"),
    ("x" * 99, "0001-" + "x" * 60),
])  # fmt: skip
def test_an_id_is_safe_in_a_path(journal: Journal, name: str, expected: str) -> None:
    assert transitions.submit(journal, name, "", "") == expected


def test_a_request_seen_before_queues_nothing(journal: Journal) -> None:
    first = transitions.submit(journal, "a", "", "", "request-1")
    assert transitions.submit(journal, "other", "", "", "request-1") == first
    assert transitions.submit(journal, "a", "", "", "request-2") != first
    assert len(records.campaigns(journal)) == 2
    assert records.reply_to(journal, "request-1") == ("campaign.submit", {"campaign": first})


@pytest.mark.parametrize("target", WAYS_TO)
@pytest.mark.parametrize("source", get_args(CampaignState))
def test_only_the_ways_of_the_table_are_open(journal: Journal, source: CampaignState, target: CampaignState) -> None:
    id = transitions.submit(journal, "a", "", "")
    with journal.transaction("set up") as write:
        write.execute("UPDATE campaigns SET state = ? WHERE id = ?", source, id)
    seq = journal.last_seq
    is_open = source in WAYS_TO[target]
    assert transitions.move_campaign(journal, id, target, "because") is is_open
    found = records.campaign(journal, id)
    assert found is not None
    assert found.state == (target if is_open else source)
    assert journal.last_seq == seq + is_open, "a refused change leaves no event"


def test_running_again_is_reported_as_resumed(journal: Journal) -> None:
    id = transitions.submit(journal, "a", "", "")
    kinds = []
    for state in ("running", "paused", "running", "completed"):
        transitions.move_campaign(journal, id, state, data=CampaignData(name="a"))  # type: ignore[arg-type]
        kinds.append(last(journal)[0])
    assert kinds == ["campaign.started", "campaign.paused", "campaign.resumed", "campaign.completed"]


def test_a_reason_is_in_the_event_and_in_the_record(journal: Journal) -> None:
    id = transitions.submit(journal, "a", "", "")
    transitions.move_campaign(journal, id, "failed", "the rig file has changed")
    assert last(journal) == ("campaign.failed", {"reason": "the rig file has changed"})
    found = records.campaign(journal, id)
    assert found is not None
    assert found.reason == "the rig file has changed"


def test_a_step_reports_its_attempt_and_why_it_was_skipped(journal: Journal) -> None:
    step = StepData(step=2, label="s", kind="dwell", frequency_hz=5.0, amplitude_mm=None)
    transitions.start_step(journal, "c", step)
    expected = {"step": 2, "label": "s", "kind": "dwell", "frequency_hz": 5.0, "amplitude_mm": None}
    assert last(journal) == ("step.started", expected | {"attempt": 1})
    transitions.end_step(journal, "c", StepData(step=2, label="s"), "no answer")
    assert last(journal) == ("step.skipped", {"step": 2, "label": "s", "reason": "no answer"})


def test_a_result_is_published_once(journal: Journal) -> None:
    row = {"target": "T01", "capture": "c1", "ax_mm": 0.5, "flags": []}
    event = EnvelopeData(capture="c1", targets=(TargetRow.model_validate(row),))
    for expected in (True, False):
        assert transitions.record_result(journal, "c", [], envelope=[row], measurements=[], event=event) is expected
    assert last(journal) == ("envelope", {"capture": "c1", "targets": [row]})
    assert journal.last_seq == 1


def test_numbers_that_json_does_not_have_are_refused_whole(journal: Journal) -> None:
    """A row with NaN is a mistake of the program: neither result nor event may be there afterwards."""
    with pytest.raises(ValueError, match="JSON"):
        transitions.record_result(
            journal, "c", [], envelope=[{"ax_mm": float("nan")}], measurements=[], event=EnvelopeData(capture="c1")
        )
    assert journal.last_seq == 0
    assert records.result_names(journal, "c") == set()


def test_what_cannot_be_measured_is_a_fault_once(journal: Journal) -> None:
    fault = FaultData(device="worker", message="no sharp frames", capture="m1")
    transitions.give_up_measuring(journal, "c", ["m1"], fault)
    transitions.give_up_measuring(journal, "c", ["m2"], fault, is_known=True)
    assert journal.last_seq == 1
    assert last(journal)[1]["message"] == "no sharp frames"


def test_the_manual_campaign_is_made_once_without_an_event(journal: Journal) -> None:
    assert transitions.open_manual(journal) == transitions.open_manual(journal) == transitions.MANUAL
    assert journal.last_seq == 0
    [found] = records.campaigns(journal)
    assert (found.number, found.state) == (0, "completed")


def test_a_probe_leaves_no_event(journal: Journal) -> None:
    transitions.probe(journal)
    assert journal.last_seq == 0
