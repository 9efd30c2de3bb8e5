"""What is wrong with a peer, in the log: one line a peer and minute, however often it happens."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict

from labdaemon.stream.text_limits import bounded_text

EVERY_S = 60.0  # a flood of refusals must not fill the log
MOST_PEERS = 64
"""Peers that are kept apart; those beyond share a line."""
OTHERS = "other peers"


class PeerLog:
    """Writes warnings about peers.

    Parameters
    ----------
    log
        Where they go.
    server
        Which server's peers they are.
    """

    def __init__(self, log: logging.Logger, server: str) -> None:
        self._log, self._server = log, server
        self._last: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def warn(self, peer: str, why: str) -> None:
        """Log it, or count it until a minute has passed."""
        now_s = time.monotonic()
        if peer not in self._last and len(self._last) >= MOST_PEERS:
            oldest, (logged_s, _) = next(iter(self._last.items()))
            if now_s - logged_s >= EVERY_S:
                del self._last[oldest]
            else:
                peer = OTHERS
        logged_s, unlogged = self._last.get(peer, (-EVERY_S, 0))
        if now_s - logged_s < EVERY_S:
            self._last[peer] = (logged_s, unlogged + 1)
            return
        self._last.pop(peer, None)
        self._last[peer] = (now_s, 0)
        more = f" ({unlogged} more times since the last line)" if unlogged else ""
        self._log.warning("%s: %s: %s%s", self._server, peer, bounded_text(why, 200), more)
