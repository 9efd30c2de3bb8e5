"""Writes the page of each campaign that ends, ``results/index.html``, as `labdaemon report` does.

Drawing takes seconds of a processor, so a process of its own does it, one at a time and at low priority. Whatever
becomes of it, the daemon is not held up by it; the page can be written again by hand.
"""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

from labdaemon.capture.paths import campaign_folder
from labdaemon.child_program import run_module
from labdaemon.errors import LabdaemonError
from labdaemon.journal.journal import Journal
from labdaemon.off_loop import off_loop
from labdaemon.processing import RESULTS

KINDS = ("campaign.completed", "campaign.aborted", "campaign.failed")
LONGEST_S = 1800.0
"""A page that takes longer is given up: the disk or the network drive does not answer."""
NICENESS = 10

log: logging.Logger = logging.getLogger(__name__)


class CampaignReports:
    """Follows the journal, and has the page of each campaign written when that has ended.

    Parameters
    ----------
    journal
        Where events are read from, beginning with the next one.
    data
        The daemon's data folder.
    """

    def __init__(self, journal: Journal, data: Path) -> None:
        self._journal, self._data = journal, data
        self._changed = asyncio.Event()
        self._seq = journal.last_seq

    def wake(self) -> None:
        """Something was committed. Cheap; call it on the loop's thread."""
        self._changed.set()

    async def run(self) -> None:
        """Write pages until cancelled; one that is being written then is left."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            last = self._journal.last_seq
            try:
                ended = await off_loop(self._ended, self._seq)
            except (LabdaemonError, RuntimeError) as exc:  # RuntimeError: no thread is left at this moment
                log.warning("ended campaigns cannot be read: %s", exc)
                continue
            self._seq = last
            for campaign in ended:
                await self._write(campaign_folder(self._data, campaign))

    def _ended(self, after: int) -> list[str]:
        marks = ",".join("?" * len(KINDS))
        rows = self._journal.read(
            f"SELECT campaign FROM events WHERE seq > ? AND kind IN ({marks}) ORDER BY seq", after, *KINDS
        )
        return [campaign for (campaign,) in rows]

    async def _write(self, folder: Path) -> None:
        if not (folder / RESULTS / "envelope.csv").is_file():
            return  # it ended before its first result
        try:
            result = await run_module("labdaemon", "report", str(folder), longest_s=LONGEST_S, niceness=NICENESS)
        except TimeoutError:
            log.warning("the report of %s took longer than %.0f s and was given up", folder.name, LONGEST_S)
        except OSError as exc:
            log.warning("the report of %s cannot be written: %s; labdaemon report writes it", folder.name, exc)
        else:
            if result.status:
                log.warning("the report of %s was not written: %s", folder.name, result.complaint)
