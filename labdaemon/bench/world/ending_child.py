"""The daemon as the endings run it: it hangs, or uses up memory, when a line on standard input says so.

``python -m labdaemon.bench.world.ending_child CONFIG DATA``; the lines are ``hang`` and ``memory``.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
import time
from pathlib import Path

from labdaemon.bench.kill_child import QuickMeasurer
from labdaemon.service.config import load_rig
from labdaemon.service.daemon import DaemonOptions, run_daemon

BLOCK_BYTES = 1 << 20  # as a file is usually copied


def _obey(loop: asyncio.AbstractEventLoop) -> None:
    for line in sys.stdin:
        if line.strip() == "hang":
            loop.call_soon_threadsafe(time.sleep, 1e6)
        if line.strip() == "memory":
            held = []
            while True:
                held.append(b"\x01" * BLOCK_BYTES)


def main(arguments: list[str]) -> int:
    """Run it."""
    config, data = arguments
    for number in (signal.SIGHUP, signal.SIGQUIT):  # ignored where the bench itself runs under nohup
        signal.signal(number, signal.SIG_DFL)

    def ready(commands: str, events: str) -> None:
        threading.Thread(target=_obey, args=(asyncio.get_running_loop(),), daemon=True).start()
        print(json.dumps({"commands": commands, "events": events}), flush=True)

    return run_daemon(
        load_rig(Path(config)),
        DaemonOptions(Path(data)),
        ready=ready,
        measurer=lambda pool, _: QuickMeasurer(pool),
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
