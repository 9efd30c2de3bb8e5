"""The campaign that a command is about."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.campaign.lookup import has_ended, named_campaign, outline, state_of
from labdaemon.campaign.steps import Plan, SettleRule, Step
from labdaemon.clock import SimulatedClock
from labdaemon.events import StepData
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.stream.messages import NotFoundError, WrongStateError


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


def step(index: int, predicted_s: float, predicted_bytes: int) -> Step:
    return Step(
        index, 0, "dwell", f"s{index}", 5.0, 1.0, (), False, SettleRule(), "retry", predicted_s, predicted_bytes
    )


def test_a_campaign_is_found_by_id_and_state(journal: Journal) -> None:
    id = transitions.submit(journal, "night", "toml", "digest")
    assert named_campaign(journal, id, None, "queued").id == id
    with pytest.raises(WrongStateError, match=f"{id} is queued, not running or paused"):
        named_campaign(journal, id, None, "running", "paused")


def test_without_an_id_it_is_the_current_one(journal: Journal) -> None:
    id = transitions.submit(journal, "night", "toml", "digest")
    current = records.campaign(journal, id)
    assert named_campaign(journal, None, current, "queued") == current
    with pytest.raises(NotFoundError, match="submit one"):
        named_campaign(journal, None, None, "running")


def test_the_journal_decides_not_what_the_caller_remembers(journal: Journal) -> None:
    """Another request may have moved it meanwhile."""
    id = transitions.submit(journal, "night", "toml", "digest")
    remembered = records.campaign(journal, id)
    transitions.move_campaign(journal, id, "running")
    assert named_campaign(journal, None, remembered, "running").state == "running"


def test_unknown_ids_are_named(journal: Journal) -> None:
    with pytest.raises(NotFoundError, match="'0099-x'"):
        named_campaign(journal, "0099-x", None, "running")
    assert state_of(journal, "0099-x") is None


def test_a_step_has_ended_once_it_is_completed_or_skipped(journal: Journal) -> None:
    id = transitions.submit(journal, "night", "toml", "digest")
    assert not has_ended(journal, id, 0)
    transitions.start_step(journal, id, StepData(step=0))
    assert not has_ended(journal, id, 0)
    transitions.end_step(journal, id, StepData(step=0))
    assert has_ended(journal, id, 0)
    transitions.end_step(journal, id, StepData(step=1), "shaker: no answer")
    assert has_ended(journal, id, 1)


def test_the_outline_sums_the_plan() -> None:
    plan = Plan("night", (step(0, 10.04, 7), step(1, 20.0, 8)), "toml", "digest")
    assert (plan.predicted_s, plan.predicted_bytes) == (30.04, 15)
    assert outline(plan).to_json_dict() == {"name": "night", "steps": 2, "predicted_s": 30.0}
