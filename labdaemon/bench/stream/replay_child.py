"""``python -m labdaemon.bench.stream.replay_child COMMANDS``: read all history there is.

Prints how many seconds that took, and how many of them its own CPU time were.
"""

from __future__ import annotations

import sys
import time

from labdaemon.stream.client import Client


def main(commands: str) -> None:
    """Ask until the last event is there; each answer is parsed, as any client does."""
    with Client(commands, timeout_s=60.0) as client:
        began_s, used_s, seq, last = time.monotonic(), time.process_time(), 0, 1
        while seq < last:
            answer = client.replay(seq)
            seq, last = answer["events"][-1]["seq"], answer["last"]
        print(time.monotonic() - began_s, time.process_time() - used_s)


if __name__ == "__main__":
    main(*sys.argv[1:])
