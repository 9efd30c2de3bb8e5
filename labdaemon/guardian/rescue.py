"""What the guardian does when the daemon is gone: stop the table again and again until it is seen at rest."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from labdaemon.guardian.recipe import StopRecipe
from labdaemon.guardian.rescue_reporter import RescueReporter
from labdaemon.guardian.wire import StopFailure, stop_shaker

TRY_S = 15.0
"""A try that takes longer hangs in the system (a driver that waits for its adapter): it is left and another begins."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.05, 1.0
REPEAT_S = 10.0
"""How often the emergency stop is named again while the table is not seen at rest."""
HAND_OVER_S = 4.0
"""A daemon that waits takes over after so long without success: it has more ways to stop the table."""

EMERGENCY = "THE TABLE IS NOT SEEN AT REST: use the emergency stop"


class RescueOutcome(NamedTuple):
    """How a rescue ended.

    Attributes
    ----------
    is_at_rest
        Whether the shaker confirmed rest.
    tries
        How many tries were made.
    after_s
        Seconds from its beginning to its end.
    trouble
        What the last failed try met; empty where none failed.
    """

    is_at_rest: bool
    tries: int
    after_s: float
    trouble: str


def rescue(
    recipe: StopRecipe,
    reporter: RescueReporter,
    *,
    patience_s: float,
    is_wanted: Callable[[], bool],
    stop: Callable[[StopRecipe], None] = stop_shaker,
) -> RescueOutcome:
    """Stop the table.

    Parameters
    ----------
    patience_s
        After so long without success it ends; by then a person has come or another daemon has been started.
    is_wanted
        Whether a newer daemon waits to take over.
    """
    began = said = time.monotonic()
    trouble, tries, pause_s = "", 0, FIRST_PAUSE_S
    while True:
        tries += 1
        failure = _try(recipe, stop)
        after_s = time.monotonic() - began
        if failure is None:
            return RescueOutcome(True, tries, after_s, trouble)
        if not trouble or time.monotonic() >= said + REPEAT_S:
            reporter.say(f"{EMERGENCY} ({recipe.device}: {failure}; try {tries})")
            said = time.monotonic()
        trouble = failure
        if after_s >= patience_s or (after_s >= HAND_OVER_S and is_wanted()):
            return RescueOutcome(False, tries, after_s, trouble)
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


def _try(recipe: StopRecipe, stop: Callable[[StopRecipe], None]) -> str | None:
    """One try in a thread of its own; what it met, None when the table is at rest."""
    met: list[str | None] = []

    def work() -> None:
        try:
            stop(recipe)
        except StopFailure as exc:
            met.append(str(exc))
        except Exception as exc:  # whatever a port raises, the next try must come
            met.append(f"{type(exc).__name__}: {exc}")
        else:
            met.append(None)

    thread = threading.Thread(target=work, name="stop", daemon=True)
    thread.start()
    thread.join(TRY_S)
    return met[0] if met else f"the port {recipe.port} hangs"
