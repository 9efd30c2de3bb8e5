"""Free ports of loopback for servers that must know theirs before they start, or come back at the same one."""

from __future__ import annotations

import itertools
import os
import socket

FIRST, COUNT = 20_000, 12_000
"""Below 32768, where Linux takes the ports of outgoing connections from. A port of theirs may be taken by any of them
between the choice and the start, and a client that tries it again and again may even connect to itself."""
_turns = itertools.count()


def free_port() -> int:
    """A TCP port of loopback that no one has now, and that outgoing connections do not take.

    Raises
    ------
    OSError
        All are taken.
    """
    for turn in itertools.islice(_turns, COUNT):
        port = FIRST + (os.getpid() * 101 + turn) % COUNT  # processes begin at different places
        with socket.socket() as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                sock.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise OSError(f"no port of {FIRST} to {FIRST + COUNT - 1} is free")


def free_address() -> str:
    """`free_port` as ``tcp://127.0.0.1:PORT``."""
    return f"tcp://127.0.0.1:{free_port()}"
