"""What there is to know of campaigns: a list, one in full, and the order of the queue."""

from __future__ import annotations

from typing import Any

from labdaemon.campaign.engine import Engine
from labdaemon.campaign.measurement_queue import RESULTS
from labdaemon.capture.paths import campaign_folder
from labdaemon.journal import queue_order, records
from labdaemon.journal.records import CampaignRecord
from labdaemon.stream.messages import NotFoundError, WrongStateError

MOST_LISTED = 1000


class CampaignQueries:
    """Answers about the campaigns of an engine's journal; its methods read the disk.

    Parameters
    ----------
    engine
        What runs them.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._journal = engine.context.recorder.journal

    def list(self, limit: int) -> dict[str, Any]:
        """The newest campaigns, at most `limit`, and those that wait or run, however old."""
        found = records.campaigns(self._journal)
        present = [one for one in found if one.state in {"queued", "running", "paused"}]
        newest = {one.id: one for one in [*found[max(len(found) - limit, 0) :], *present]}
        places = {id: place for place, id in enumerate(queue_order.queued(self._journal))}
        shown = sorted(newest.values(), key=lambda one: -one.number)
        return {"campaigns": [self._summary(one, places) for one in shown], "total": len(found)}

    def show(self, campaign: str | None) -> dict[str, Any]:
        """One campaign in full; the current one where none is named.

        Raises
        ------
        NotFoundError
            There is no such campaign.
        """
        record = records.campaign(self._journal, campaign) if campaign is not None else self._engine.current
        if record is None:
            named = f"no campaign {campaign[:80]!r}" if campaign is not None else "no campaign is in progress"
            raise NotFoundError(named)
        places = {id: place for place, id in enumerate(queue_order.queued(self._journal))}
        steps = sorted(records.steps(self._journal, record.id).items())
        return {
            **self._summary(record, places),
            "toml": record.toml,
            "steps": [
                {"step": index, "state": step.state, "attempts": step.attempts, "reason": step.reason}
                for index, step in steps
            ],
            "captures": sum(records.captures_by_step(self._journal, record.id).values()),
        }

    async def move(self, campaign: str, place: int) -> dict[str, Any]:
        """Give a queued campaign another place.

        Raises
        ------
        NotFoundError, WrongStateError
            There is no such campaign, or it does not wait.
        """
        order = await self._engine.context.recorder.write(queue_order.place_campaign, campaign, place)
        if order is None:
            record = records.campaign(self._journal, campaign)
            if record is None:
                raise NotFoundError(f"no campaign {campaign[:80]!r}")
            raise WrongStateError(f"campaign {record.id} is {record.state} and does not wait")
        return {"campaign": campaign, "queue": order}

    def _summary(self, record: CampaignRecord, places: dict[str, int]) -> dict[str, Any]:
        folder = campaign_folder(self._engine.context.data, record.id)
        return {
            "id": record.id,
            "name": record.name,
            "state": record.state,
            "reason": record.reason,
            "submitted_at": record.submitted_at,
            "place": places.get(record.id),
            "folder": str(folder),
            "results": str(folder / RESULTS),
        }
