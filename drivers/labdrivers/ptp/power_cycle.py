"""Switching a dead camera's supply off and on through a relay: the last remedy when nobody is in the room.

Bodies lock up after thousands of shots and then answer nothing until they lose power. The relay is the laboratory's
own; what operates it is a command in the rig file, run without a shell, seldom, and with a deadline.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Sequence

from labdaemon.errors import DeviceRefused

COMMAND_S = 30.0
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
            done = subprocess.run(
                self._command, capture_output=True, text=True, timeout=COMMAND_S, stdin=subprocess.DEVNULL, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as exc:
            raise DeviceRefused(f"power_cycle command fails ({exc}); check it by hand", device=self._device) from exc
        if done.returncode != 0:
            said = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["nothing said"]
            raise DeviceRefused(
                f"power_cycle command ends with status {done.returncode} ({said[0]}); check it by hand",
                device=self._device,
            )
