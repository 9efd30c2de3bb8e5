"""A serial wire as slow as a real one, between the daemon and a simulated controller, that notes when each line passed.

``python -m labdaemon.bench.world.paced_wire HOST PORT`` prints the port on which it listens, then a line of JSON for
each line that the daemon sent: ``at_s``, when its last bit had left at the wire's speed (monotonic clock of the
machine), and ``text``. A process of its own: its times must not wait for what else is measured.
"""

from __future__ import annotations

import json
import queue
import socket
import sys
import threading
import time

BYTE_S = 10.0 / 9600.0
"""A byte with start and stop bit at 9600 baud."""
REPLY_S = 0.02
"""A controller thinks so long before it answers."""

Chunk = tuple[float, bytes]


def main() -> None:
    """Relay one connection after another until standard input closes."""
    host, port = sys.argv[1], int(sys.argv[2])
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            daemon, _ = listener.accept()
            try:
                controller = socket.create_connection((host, port), timeout=5.0)
            except OSError:  # one side has closed: the other is closed below
                daemon.close()
                continue
            controller.settimeout(None)
            for sock in (daemon, controller):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=_relay, args=(daemon, controller, 0.0, True), daemon=True).start()
            threading.Thread(target=_relay, args=(controller, daemon, REPLY_S, False), daemon=True).start()


def _relay(source: socket.socket, target: socket.socket, delay_s: float, is_noted: bool) -> None:
    """Pass bytes on at the wire's speed; bytes queue on the wire as they do in a port's buffer."""
    arrived: queue.SimpleQueue[Chunk | None] = queue.SimpleQueue()
    threading.Thread(target=_send, args=(arrived, target, delay_s, is_noted), daemon=True).start()
    try:
        while data := source.recv(4096):
            arrived.put((time.monotonic(), data))
    except OSError:
        pass  # the other side was closed first
    arrived.put(None)


def _send(arrived: queue.SimpleQueue[Chunk | None], target: socket.socket, delay_s: float, is_noted: bool) -> None:
    free_s, line = 0.0, b""
    while (chunk := arrived.get()) is not None:
        came_s, data = chunk
        for place in range(len(data)):
            byte = data[place : place + 1]
            free_s = max(free_s, came_s + delay_s) + BYTE_S
            time.sleep(max(free_s - time.monotonic(), 0.0))
            try:
                target.sendall(byte)
            except OSError:
                break
            line += byte
            if byte == b"\n":
                if is_noted:
                    print(json.dumps({"at_s": free_s, "text": line.decode("ascii", "replace").strip()}), flush=True)
                line = b""
    target.close()


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    import os

    os._exit(0)


if __name__ == "__main__":
    main()
