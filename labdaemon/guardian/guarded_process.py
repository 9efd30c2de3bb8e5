"""The daemon that is guarded, as a process: whether it lives, and its end when it hangs."""

from __future__ import annotations

import os
import select
import signal
import time
from contextlib import suppress

END_S = 0.3
"""How long a killed process may take to be gone. One that waits for a disk takes longer; the stop does not wait."""


class GuardedProcess:
    """The process that started the guardian, held by a descriptor that no later process can have.

    Parameters
    ----------
    pid
        The daemon's own word for its process id. Our parent is not always the daemon: if that has died already, it is
        whoever adopts orphans (init, a user's systemd), which must never be killed.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._file: int | None = None
        with suppress(OSError, AttributeError):  # an old kernel: the parent's id serves, as long as it is our parent
            self._file = os.pidfd_open(pid)
        if os.getppid() != pid:
            self.close()

    @property
    def descriptor(self) -> int | None:
        """Readable once the process has ended; None where the kernel offers none, or it had ended before."""
        return self._file

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended yet."""
        if self._file is not None:
            readable, _, _ = select.select([self._file], [], [], 0.0)
            return not readable
        return os.getppid() == self.pid

    def end(self, patience_s: float) -> bool:
        """Let it end by itself for a moment, then kill it.

        Returns
        -------
        bool
            Whether it had to be killed.
        """
        if self._ends_within(patience_s):
            return False
        with suppress(ProcessLookupError):  # it has ended meanwhile
            if self._file is not None:
                signal.pidfd_send_signal(self._file, signal.SIGKILL)
            else:
                os.kill(self.pid, signal.SIGKILL)
        self._ends_within(END_S)
        return True

    def close(self) -> None:
        """Give the descriptor back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _ends_within(self, patience_s: float) -> bool:
        end = time.monotonic() + patience_s
        while self.is_alive:
            if time.monotonic() >= end:
                return False
            time.sleep(0.01)
        return True
