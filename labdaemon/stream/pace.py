"""How fast clients are served together, so that a flood leaves the event loop to the rig."""

from __future__ import annotations

import asyncio


class Pace:
    """So many units a second, shared by all that take them, each in its turn.

    Parameters
    ----------
    per_s
        Units a second in the long run.
    burst
        Units that may be taken at once.
    """

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s, self._burst = per_s, burst
        self._left = burst
        self._at_s: float | None = None
        self._turn = asyncio.Lock()

    async def take(self, units: float) -> None:
        """Wait until there are so many. Who waits is served in order of arrival."""
        loop = asyncio.get_running_loop()
        async with self._turn:
            now_s = loop.time()
            if self._at_s is not None:
                self._left = min(self._left + (now_s - self._at_s) * self._per_s, self._burst)
            self._at_s = now_s
            self._left -= units
            if self._left < 0.0:
                await asyncio.sleep(-self._left / self._per_s)
