"""The campaign that a command is about."""

from __future__ import annotations

from labdaemon.journal import records
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CampaignRecord, CampaignState
from labdaemon.stream.messages import NotFound, WrongState


def named_campaign(
    journal: Journal, id: str | None, current: CampaignRecord | None, *states: CampaignState
) -> CampaignRecord:
    """The campaign of this id, or the current one where none is given, if it is in one of these states.

    Raises
    ------
    NotFound, WrongState
        There is no such campaign, or it is in another state.
    """
    if id is None:
        if current is None:
            raise NotFound("no campaign is in progress; submit one")
        id = current.id
    record = records.campaign(journal, id)
    if record is None:
        raise NotFound(f"no campaign {id!r}")
    if record.state not in states:
        raise WrongState(f"campaign {id} is {record.state}, not {' or '.join(states)}")
    return record
