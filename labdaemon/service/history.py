"""Keeps the journal's history as long as the rig file says."""

from __future__ import annotations

from labdaemon.capture.recorder import Recorder
from labdaemon.clock import Clock
from labdaemon.journal.retention import Retention, cut_history, first_to_keep
from labdaemon.off_loop import off_loop

CHECK_S = 600.0
"""Between two looks at what has become too old."""
PAUSE_S = 0.2
"""Between two transactions, so that captures are recorded in between."""


async def keep_history(recorder: Recorder, retention: Retention, clock: Clock) -> None:
    """Cut what is older than it may be, until cancelled."""
    while True:
        before = await off_loop(first_to_keep, recorder.journal, retention)
        while await recorder.write(cut_history, before):
            await clock.sleep(PAUSE_S)
        await clock.sleep(CHECK_S)
