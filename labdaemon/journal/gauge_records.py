"""What the journal knows of gauges: their motion during each capture, from the moment its frames are worth keeping."""

from __future__ import annotations

from collections.abc import Iterable

from labdaemon.events import GaugeMotion
from labdaemon.journal.journal import Journal, Transaction


def keep_gauges(write: Transaction, campaign: str, capture: str, gauges: Iterable[GaugeMotion]) -> None:
    """Note what gauges saw during a capture, within the transaction that makes it worth keeping."""
    for one in gauges:
        write.execute(
            "INSERT OR REPLACE INTO gauge_motions VALUES (?, ?, ?, ?)",
            campaign,
            capture,
            one.gauge,
            one.model_dump_json(exclude_none=True),
        )


def gauges_of(journal: Journal, campaign: str, capture: str) -> tuple[GaugeMotion, ...]:
    """What each gauge saw during a capture, by name of the gauge."""
    rows = journal.read(
        "SELECT motion FROM gauge_motions WHERE campaign = ? AND capture = ? ORDER BY gauge", campaign, capture
    )
    return tuple(GaugeMotion.model_validate_json(row[0]) for row in rows)


def gauges_in(journal: Journal, campaign: str) -> list[tuple[str, GaugeMotion]]:
    """Capture and motion for all captures of a campaign that are stored and no sharp ones, by name of the capture."""
    rows = journal.read(
        "SELECT capture, motion FROM gauge_motions JOIN captures "
        "ON captures.campaign = gauge_motions.campaign AND captures.name = gauge_motions.capture "
        "WHERE gauge_motions.campaign = ? AND is_sharp = 0 AND state IN ('stored', 'measured', 'unmeasured') "
        "ORDER BY capture, gauge",
        campaign,
    )
    return [(row[0], GaugeMotion.model_validate_json(row[1])) for row in rows]
