"""What a peer sends is bounded by its frames, wherever the bytes are cut."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.stream.zmtp import COMMAND, GREETING_BYTES, LONG, MORE, PeerInspector, PeerLimits, PeerRefusal

GREETING = (b"\xff" + b"\0" * 8 + b"\x7f\x03\x00NULL").ljust(GREETING_BYTES, b"\0")
LIMITS = PeerLimits(frame_bytes=1000, message_bytes=3000, topics=3)


def frame(body: bytes, flags: int = 0) -> bytes:
    if len(body) > 255:
        return bytes([flags | LONG]) + len(body).to_bytes(8, "big") + body
    return bytes([flags, len(body)]) + body


READY = frame(b"\x05READY\x0bSocket-Type\0\0\0\x03SUB", COMMAND)
HELLO = GREETING + READY


def outcome(data: bytes, cuts: list[int]) -> str:
    inspector = PeerInspector(LIMITS)
    try:
        for begin, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
            inspector.feed(data[begin:end])
    except PeerRefusal as exc:
        return str(exc)
    return "ready" if inspector.is_ready else "peer" if inspector.is_peer else "unknown"


STREAMS = {
    "nothing": (b"", "unknown"),
    "half a greeting": (GREETING[:12], "peer"),
    "greeting": (GREETING, "peer"),
    "hello": (HELLO, "ready"),
    "http": (b"GET / HTTP/1.1\r\n\r\n", "no ZeroMQ peer"),
    "tls": (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", "no ZeroMQ peer"),
    "old": (GREETING[:10] + b"\x01\x02", "a ZeroMQ peer older than version 4"),
    "no frame": (GREETING + b"\x80\x00", "bytes that are no frame"),
    "long hello": (GREETING + frame(b"x" * 5000, COMMAND), "a frame of more than 4096 bytes"),
    "frames": (HELLO + frame(b"x" * 1000) * 50, "ready"),
    "long frame": (HELLO + frame(b"x" * 1001), "a frame of more than 1000 bytes"),
    "endless frame": (HELLO + bytes([LONG]) + b"\xff" * 8, "a frame of more than 1000 bytes"),
    "endless message": (HELLO + frame(b"x", MORE) * 200, "a message of more than 3000 bytes"),
    "topics": (HELLO + frame(b"\1a") + frame(b"\1b") + frame(b"\x09SUBSCRIBEc", COMMAND), "ready"),
    "many topics": (HELLO + frame(b"\1a") * 3 + frame(b"\x09SUBSCRIBEa", COMMAND), "more than 3 subscriptions"),
    "changing topics": (HELLO + (frame(b"\1a") + frame(b"\0a") + frame(b"")) * 50, "ready"),
    "cancelled": (HELLO + (frame(b"\x09SUBSCRIBEc", COMMAND) + frame(b"\x06CANCELc", COMMAND)) * 50, "ready"),
    "pings": (HELLO + frame(b"\x04PING\0\0", COMMAND) * 500, "ready"),
}


@pytest.mark.parametrize(("data", "expected"), STREAMS.values(), ids=STREAMS)
def test_peers_are_known_by_their_bytes(data: bytes, expected: str):
    assert outcome(data, []) == expected
    assert outcome(data, list(range(1, len(data)))) == expected


@given(st.sampled_from(sorted(STREAMS)), st.data())
def test_cuts_make_no_difference(name: str, data: st.DataObject):
    sent, expected = STREAMS[name]
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=6)))
    assert outcome(sent, cuts) == expected


@given(st.lists(st.integers(0, 400), max_size=6))
def test_the_identity_is_taken_out_and_nothing_else_changes(cuts: list[int]):
    hello = frame(b"\x05READY\x0bSocket-Type\0\0\0\x06DEALER\x08Identity\0\0\0\x02me", COMMAND)
    sent = GREETING + hello + frame(b"\x08Identity" * 5) * 5
    inspector, passed = PeerInspector(LIMITS), b""
    cuts = sorted(min(cut, len(sent)) for cut in cuts)
    for begin, end in zip([0, *cuts], [*cuts, len(sent)], strict=True):
        passed += inspector.feed(sent[begin:end])
    assert passed == sent.replace(b"Identity", b"X-Origin", 1)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_peers_or_refused(data: bytes):
    assert outcome(HELLO + data, [])
    assert outcome(data, [])


CURVE_GREETING = (b"\xff" + b"\0" * 8 + b"\x7f\x03\x00CURVE").ljust(GREETING_BYTES, b"\0")
CURVE_HELLO, CURVE_INITIATE = frame(b"\x05HELLO" + bytes(194), COMMAND), frame(b"\x08INITIATE" + bytes(300), COMMAND)
ENCRYPTED = {
    "greeting": (CURVE_GREETING, "peer"),
    "plain": (HELLO, "a peer without a key"),
    "half a greeting": (CURVE_GREETING[:14], "peer"),
    "hello alone": (CURVE_GREETING + CURVE_HELLO, "peer"),
    "ready": (CURVE_GREETING + CURVE_HELLO + CURVE_INITIATE, "ready"),
    "no hello": (CURVE_GREETING + CURVE_INITIATE, "no handshake of a peer with a key"),
    "hello twice": (CURVE_GREETING + CURVE_HELLO * 2, "no handshake of a peer with a key"),
    "plain ready": (CURVE_GREETING + READY, "no handshake of a peer with a key"),
    "long hello": (CURVE_GREETING + frame(b"\x05HELLO" + bytes(5000), COMMAND), "a frame of more than 4096 bytes"),
    "full frame": (CURVE_GREETING + CURVE_HELLO + CURVE_INITIATE + frame(bytes(1033)), "ready"),
    "long frame": (
        CURVE_GREETING + CURVE_HELLO + CURVE_INITIATE + frame(bytes(1034)), "a frame of more than 1033 bytes"
    ),
    "many frames": (CURVE_GREETING + CURVE_HELLO + CURVE_INITIATE + frame(b"\x01abc") * 300, "ready"),
}  # fmt: skip


def encrypted_outcome(data: bytes, cuts: list[int]) -> str:
    inspector = PeerInspector(LIMITS, is_encrypted=True)
    passed = b""
    try:
        for begin, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
            passed += inspector.feed(data[begin:end])
    except PeerRefusal as exc:
        return str(exc)
    assert passed == data  # nothing of it can be changed
    return "ready" if inspector.is_ready else "peer" if inspector.is_peer else "unknown"


@given(st.sampled_from(sorted(ENCRYPTED)), st.data())
def test_encrypted_peers_are_known_by_their_handshake(name: str, data: st.DataObject):
    sent, expected = ENCRYPTED[name]
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=6)))
    assert encrypted_outcome(sent, cuts) == expected


@given(st.binary(max_size=300))
def test_any_bytes_are_an_encrypted_peers_or_refused(data: bytes):
    assert encrypted_outcome(CURVE_GREETING + CURVE_HELLO + data, [])
    assert encrypted_outcome(data, [])
