"""Clients that catch up with a long history, many answers at a time, and for ever: load for other measurements.

``python -m labdaemon.bench.world.greedy_clients ADDRESS CLIENTS REPLAYS`` runs until standard input closes.
"""

from __future__ import annotations

import json
import sys
import threading

import zmq


def main() -> None:
    """Keep so many replays of each client in progress."""
    address, clients, replays = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    for _ in range(clients):
        threading.Thread(target=_ask_for_ever, args=(address, replays), daemon=True).start()
    sys.stdin.buffer.read()


def _ask_for_ever(address: str, replays: int) -> None:
    socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.DEALER)
    socket.connect(address)
    for number in range(replays):
        socket.send(_request(number))
    while True:
        socket.recv()
        socket.send(_request(0))


def _request(number: int) -> bytes:
    params = {"after": 0, "limit": 1000}
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": "events.replay", "params": params}).encode()


if __name__ == "__main__":
    main()
