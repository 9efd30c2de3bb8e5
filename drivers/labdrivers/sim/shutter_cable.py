"""The shutters' cable on the RTS line of a serial adapter, with an arm switch that is wired back to CTS.

Opening the port raises RTS for a moment, as Linux does: with the switch on that is a shot without a request.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from labdrivers.sim.faults import Faults
from labdrivers.sim.trigger_device import Shutter
from labdrivers.sim.wire import WireDevice

FAULTS = {"dead_cable": "the opto-coupler is broken: nothing is released"}


class ShutterCable(WireDevice):
    """The cable.

    Parameters
    ----------
    shutters
        The cameras on it.
    clock
        The rig's clock.

    Attributes
    ----------
    armed
        Position of the arm switch.
    """

    def __init__(self, shutters: Sequence[Shutter], *, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.faults = Faults(FAULTS)
        self._shutters, self._clock = list(shutters), clock
        self._rts = False
        self.armed = False

    @property
    def cts(self) -> bool:
        """The switch, wired back."""
        return self.armed

    def attached(self) -> None:
        """The port was opened: the line twitches."""
        self.set_rts(True)
        self.set_rts(False)

    def set_rts(self, level: bool) -> None:
        """The line; its rising edge presses the release."""
        pressed, self._rts = level and not self._rts, level
        if pressed and self.armed and not self.faults.strike("dead_cable"):
            now = self._clock()
            for shutter in self._shutters:
                shutter.release(now)

    def receive(self, data: bytes) -> None:
        """Discard what is written."""
