"""Typed events: each kind has its model, readers ignore what they do not know, mistakes are refused."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import pytest
from pydantic import ValidationError

import labdaemon as ld
from labdaemon.clock import SimulatedClock, parse_rfc3339
from labdaemon.errors import DataError
from labdaemon.events import (
    KINDS,
    CampaignData,
    CampaignStarted,
    CaptureData,
    EnvelopeData,
    EnvelopeMeasured,
    FaultData,
    FaultReported,
    StatusData,
    StatusReport,
    StepData,
    TargetRow,
    UnknownEvent,
    check_payload,
    event_schema,
    parse_event,
)
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal

AT = "2026-05-04T10:11:12.123456Z"
LEAST: dict[str, dict[str, Any]] = {
    **{kind: {} for kind in KINDS},
    **{kind: {"step": 1} for kind in KINDS if kind.startswith("step.")},
    "step.decided": {"step": 1, "search": 0},
    "capture.completed": {"capture": "c1"},
    "envelope": {"capture": "c1", "targets": [{"target": "T01"}]},
}


def message(kind: str, data: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"v": 1, "seq": 7, "at": AT, "kind": kind, "campaign": "0001-a", "journal": "u", "data": data} | more


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_its_own_class(kind: str) -> None:
    event = parse_event(message(kind, LEAST[kind]))
    assert (event.kind, event.seq, event.campaign, event.journal) == (kind, 7, "0001-a", "u")
    assert event.at == datetime(2026, 5, 4, 10, 11, 12, 123456, UTC)
    assert not isinstance(event, UnknownEvent)
    assert parse_event(json.dumps(message(kind, LEAST[kind])).encode()) == event
    assert len({type(parse_event(message(one, LEAST[one]))) for one in KINDS}) == len(KINDS)


def test_unknown_members_are_ignored_at_every_level() -> None:
    row = {"target": "T01", "ax_mm": 0.25, "flags": ["a_later_flag"], "later": 1}
    event = parse_event(message("envelope", {"capture": "c1", "targets": [row], "later": {}}, later=[]))
    assert isinstance(event, EnvelopeMeasured)
    assert event.data.targets[0].ax_mm == 0.25
    assert event.data.targets[0].flags == ("a_later_flag",)


def test_a_later_kind_is_an_unknown_event() -> None:
    event = parse_event(message("lamp.changed", {"brightness": 0.5}))
    assert isinstance(event, UnknownEvent)
    assert (event.kind, event.data["brightness"]) == ("lamp.changed", 0.5)


def test_events_do_not_change() -> None:
    event = parse_event(message("campaign.started", {"name": "night"}))
    assert isinstance(event, CampaignStarted)
    with pytest.raises(ValidationError, match="frozen"):
        event.data.name = "day"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "JSON object"),
        ("{", "EOF"),
        ("{}", "seq"),
        (json.dumps(message("envelope", {"targets": []})), "capture"),
        (json.dumps(message("step.started", {"step": "first"})), "step"),
        (json.dumps(message("fault", {}, at="yesterday")), "at"),
    ],
)
def test_what_is_no_event_is_refused_by_member(text: str, expected: str) -> None:
    with pytest.raises(DataError, match=expected):
        parse_event(text)


def test_the_front_door_has_them() -> None:
    assert ld.parse_event is parse_event
    assert ld.events.FaultReported is FaultReported
    assert set(ld.events.__all__) <= set(dir(ld.events))


def test_the_schema_names_every_kind() -> None:
    schema = event_schema()
    assert set(schema["discriminator"]["mapping"]) == set(KINDS)
    assert "sd_ax_mm" in schema["$defs"]["TargetRow"]["properties"]


def test_status_reads_what_a_starting_daemon_sends() -> None:
    data = {"state": "starting", "waiting_for": {"left": "no answer"}, "table": "rest", "guardian": None}
    event = parse_event(message("status", data, campaign=None))
    assert isinstance(event, StatusReport)
    assert event.data.waiting_for["left"] == "no answer"


def test_the_journal_checks_an_event_when_it_is_made(tmp_path) -> None:
    journal = Journal(tmp_path, SimulatedClock())
    with pytest.raises(ValidationError, match="capture"):
        EnvelopeData.model_validate({"targets": []})
    fault = {"device": 3, "message": "/data/\udcff: is full", "step": None}  # a driver of a lab's own; no UTF-8
    transitions.fault(journal, None, FaultData.model_validate(fault))
    [event] = journal.events_after(0, 10)
    assert event.data == {"device": "3", "message": "/data/\\udcff: is full", "step": None}, (
        "what is not stated is left out"
    )
    typed = parse_event(event.as_dict())
    assert isinstance(typed, FaultReported)
    assert typed.data.device == "3"
    journal.close()


def test_a_kind_that_no_model_has_is_a_mistake() -> None:
    with pytest.raises(ValueError, match=r"no event has the kind 'step\.stopped'"):
        check_payload("step.stopped", StepData(step=1))


def test_a_kind_takes_its_own_model_only() -> None:
    for kind in KINDS:
        right = type(parse_event(message(kind, LEAST[kind])).data)
        assert isinstance(right, type)
        for other in (CampaignData(), StepData(step=1), CaptureData(capture="c"), FaultData(), StatusData()):
            if type(other) is right:
                check_payload(kind, other)
            else:
                with pytest.raises(ValueError, match=right.__name__):
                    check_payload(kind, other)


def test_times_go_to_json_in_the_form_of_all_times() -> None:
    """Six digits of a second, also where they are zeros: the form of files, records and messages."""
    moment = datetime(2026, 5, 4, 10, 11, 12, tzinfo=UTC)
    assert CaptureData(capture="c", opened_at=moment).to_json_dict() == {
        "capture": "c", "opened_at": "2026-05-04T10:11:12.000000Z",
    }  # fmt: skip
    assert parse_rfc3339(AT) == datetime(2026, 5, 4, 10, 11, 12, 123456, UTC)
    assert EnvelopeData(capture="c", opened_at=parse_rfc3339(AT)).to_json_dict()["opened_at"] == AT


def test_a_row_goes_to_json_as_it_came() -> None:
    row = {"capture": "c1", "target": "T01", "x_mm": 1.5, "ax_mm": None, "flags": ["at_rest"], "sign": -1}
    payload = EnvelopeData(capture="c1", targets=(TargetRow.model_validate(row),))
    assert payload.to_json_dict()["targets"] == [row]
