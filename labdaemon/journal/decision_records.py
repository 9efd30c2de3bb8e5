"""Decisions of searches for modes as the journal keeps them: after a restart the same steps follow."""

from __future__ import annotations

from labdaemon.events import DecisionData
from labdaemon.journal.journal import Journal, Transaction


def keep_decision(write: Transaction, campaign: str, decision: DecisionData) -> None:
    """Note a decision, within the transaction that reports it."""
    text = decision.model_dump_json()
    write.execute("INSERT OR REPLACE INTO step_decisions VALUES (?, ?, ?)", campaign, decision.step, text)


def decisions_of(journal: Journal, campaign: str) -> dict[int, DecisionData]:
    """A campaign's decisions by the index of their step, ascending."""
    rows = journal.read("SELECT step, decision FROM step_decisions WHERE campaign = ? ORDER BY step", campaign)
    return {int(step): DecisionData.model_validate_json(text) for step, text in rows}
