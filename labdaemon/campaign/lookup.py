"""The campaign that a command is about."""

from __future__ import annotations

from labdaemon.campaign.steps import Plan
from labdaemon.events import CampaignData
from labdaemon.journal import records
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CampaignRecord, CampaignState
from labdaemon.stream.messages import NotFoundError, WrongStateError


def named_campaign(
    journal: Journal, id: str | None, current: CampaignRecord | None, *states: CampaignState
) -> CampaignRecord:
    """The campaign of this id, or the current one where none is given, if it is in one of these states.

    Raises
    ------
    NotFoundError, WrongStateError
        There is no such campaign, or it is in another state.
    """
    if id is None:
        if current is None:
            raise NotFoundError("no campaign is in progress; submit one")
        id = current.id
    record = records.campaign(journal, id)
    if record is None:
        raise NotFoundError(f"no campaign {id!r}")
    if record.state not in states:
        raise WrongStateError(f"campaign {id} is {record.state}, not {' or '.join(states)}")
    return record


def state_of(journal: Journal, campaign: str) -> CampaignState | None:
    """The campaign's state by the journal, None if there is none of this id."""
    record = records.campaign(journal, campaign)
    return record.state if record is not None else None


def has_ended(journal: Journal, campaign: str, step: int) -> bool:
    """Whether a step was completed or skipped."""
    kept = records.step(journal, campaign, step)
    return kept is not None and kept.state != "running"


def outline(plan: Plan) -> CampaignData:
    """What the start of a campaign reports of it."""
    return CampaignData(name=plan.name, steps=len(plan.steps), predicted_s=round(plan.predicted_s, 1))
