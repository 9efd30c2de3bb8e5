"""A daemon's silence, reported once: what the clients that follow it share."""

from __future__ import annotations

import time
from collections.abc import Callable

from labdaemon.errors import LabdaemonError
from labdaemon.stream.client_errors import HeartbeatLost


class SilenceReport:
    """Reports `HeartbeatLost` once a silence.

    Parameters
    ----------
    address
        Of the events, for the message.
    report
        Called with the trouble.
    lost_s
        Silence from which it is reported.
    """

    def __init__(self, address: str, report: Callable[[LabdaemonError], object], lost_s: float) -> None:
        self._address, self._report, self._lost_s = address, report, lost_s
        self._heard_s, self._is_lost = time.monotonic(), False

    def heard(self) -> None:
        """An event came."""
        self._heard_s, self._is_lost = time.monotonic(), False

    def check(self) -> None:
        """Nothing came: report it, if that is new."""
        silent_s = time.monotonic() - self._heard_s
        if silent_s >= self._lost_s and not self._is_lost:
            self._is_lost = True
            self._report(HeartbeatLost(self._address, silent_s))
