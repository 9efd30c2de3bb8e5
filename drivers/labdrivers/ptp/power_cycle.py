"""Switching a dead camera's supply off and on through a relay: the last remedy when no person is in the room.

Bodies lock up after thousands of shots and then answer nothing until they lose power. The relay is the laboratory's
own; what operates it is a command in the rig file, run without a shell, seldom, and with a deadline.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from labdaemon.errors import DeviceRefused
from labdaemon.hook import HookError, run_hook

COMMAND_S = 30.0  # switching a hub's port takes a few seconds, whatever program does it
AT_LEAST_EVERY_S = 300.0
"""A body that needs it more often than this needs a person."""


class PowerCycle:
    """The hook of one camera.

    Parameters
    ----------
    device
        The camera's name in the rig file.
    command
        Program and arguments; empty for none.
    """

    def __init__(self, device: str, command: Sequence[str]) -> None:
        self._device, self._command = device, list(command)
        self._last: float | None = None

    def due(self) -> bool:
        """Whether there is a hook and it was not used lately."""
        return bool(self._command) and (self._last is None or time.monotonic() > self._last + AT_LEAST_EVERY_S)

    def run(self) -> None:
        """Run the command.

        Raises
        ------
        DeviceRefused
            It cannot be started, fails, or does not end.
        """
        self._last = time.monotonic()
        try:
            done = run_hook(self._command, COMMAND_S)
        except HookError as exc:
            raise DeviceRefused(f"power_cycle command fails ({exc}); check it by hand", device=self._device) from exc
        if done.status != 0:
            raise DeviceRefused(
                f"power_cycle command ends with status {done.status} ({done.last_line or 'it printed nothing'}); "
                "check it by hand",
                device=self._device,
            )
