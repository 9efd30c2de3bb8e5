"""Follow a daemon: ``python follow_stream.py [COMMANDS EVENTS]`` prints each envelope until Ctrl-C."""

from __future__ import annotations

import sys

import labdaemon as ld


def main(*addresses: str, count: int | None = None) -> None:
    """Print one line per envelope; stop after `count` of them."""
    with ld.Client(*addresses) as lab:
        seen = 0
        for event in lab.typed_events(after=0):
            if isinstance(event, ld.events.EnvelopeMeasured):
                print(event.data.envelope())
                seen += 1
                if seen == count:
                    return


if __name__ == "__main__":
    main(*sys.argv[1:])
