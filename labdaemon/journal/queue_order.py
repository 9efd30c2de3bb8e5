"""The order in which queued campaigns run: that of submission, unless a person moves one."""

from __future__ import annotations

from labdaemon.journal.journal import Journal


def queued(journal: Journal) -> list[str]:
    """Ids of the campaigns that wait, the next one first."""
    return [str(row[0]) for row in journal.read(_QUEUE)]


def place_campaign(journal: Journal, campaign: str, place: int) -> list[str] | None:
    """Give a queued campaign another place, counted from 0; beyond the end is the end.

    Returns
    -------
    list[str]
        The queue as it is now; None, and nothing changed, where the campaign does not wait (any more).
    """
    with journal.transaction("campaign.moved") as write:
        rows = write.execute(_QUEUE).fetchall()
        order = [str(row[0]) for row in rows]
        if campaign not in order:
            return None
        order.remove(campaign)
        order.insert(place, campaign)
        # The keys are dealt out anew, so that whoever is submitted later still comes later.
        for id, key in zip(order, [row[1] for row in rows], strict=True):
            write.execute("INSERT OR REPLACE INTO queue_places VALUES (?, ?)", id, key)
    return order


_QUEUE = (
    "SELECT campaigns.id, coalesce(queue_places.place, campaigns.number) AS key FROM campaigns "
    "LEFT JOIN queue_places ON queue_places.campaign = campaigns.id WHERE campaigns.state = 'queued' ORDER BY key"
)
