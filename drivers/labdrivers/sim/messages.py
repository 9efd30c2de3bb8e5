"""Messages between a simulator's process and those who use it: a JSON head and bytes behind it, over a stream socket.

u32 length of the head, u32 length of the bytes (little-endian), the head as UTF-8 JSON, the bytes.
"""

from __future__ import annotations

import json
import socket
import struct
from typing import Any
from urllib.parse import urlsplit

LENGTHS = struct.Struct("<II")
BIGGEST_HEAD = 1 << 26


def connect(url: str, *, timeout_s: float = 5.0) -> socket.socket:
    """Connect to ``tcp://host:port``."""
    parts = urlsplit(url)
    if parts.scheme != "tcp" or parts.hostname is None or parts.port is None:
        raise ValueError(f"{url!r} is no address; write tcp://host:port")
    peer = socket.create_connection((parts.hostname, parts.port), timeout=timeout_s)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return peer


def send(peer: socket.socket, head: dict[str, Any], data: bytes = b"") -> None:
    """Send one message."""
    text = json.dumps(head).encode()
    peer.sendall(LENGTHS.pack(len(text), len(data)) + text + data)


def receive(peer: socket.socket) -> tuple[dict[str, Any], bytes]:
    """Receive one message; `EOFError` when the other side is gone."""
    text_size, data_size = LENGTHS.unpack(_exactly(peer, LENGTHS.size))
    if text_size > BIGGEST_HEAD:
        raise EOFError("not a message")
    head = json.loads(_exactly(peer, text_size))
    return head, _exactly(peer, data_size)


def _exactly(peer: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        chunk = peer.recv(min(size - len(data), 1 << 20))
        if not chunk:
            raise EOFError("connection closed")
        data += chunk
    return bytes(data)
