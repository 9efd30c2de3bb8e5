"""What is wrong with a peer, in the log: one line a peer and minute."""

from __future__ import annotations

import logging

import pytest

from labdaemon.stream import peer_log
from labdaemon.stream.peer_log import EVERY_S, MOST_PEERS, OTHERS, PeerLog


class Clock:
    """Monotonic time as a test sets it."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(peer_log, "time", clock)
    return clock


@pytest.fixture
def peers(clock: Clock) -> PeerLog:
    return PeerLog(logging.getLogger("test.peers"), "web")


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


def test_a_flood_of_one_peer_is_one_line_a_minute(
    peers: PeerLog, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(1000):
        peers.warn("1.2.3.4", "wrong token")
    clock.now_s += EVERY_S
    peers.warn("1.2.3.4", "wrong token")
    assert lines(caplog) == [
        "web: 1.2.3.4: wrong token",
        "web: 1.2.3.4: wrong token (999 more times since the last line)",
    ]


def test_peers_are_kept_apart(peers: PeerLog, caplog: pytest.LogCaptureFixture) -> None:
    peers.warn("a", "wrong token")
    peers.warn("b", "bad request")
    assert lines(caplog) == ["web: a: wrong token", "web: b: bad request"]


def test_a_crowd_shares_a_line(peers: PeerLog, clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    """Addresses are many where somebody scans: neither the log nor the memory may grow with them."""
    for number in range(10 * MOST_PEERS):
        peers.warn(f"peer {number}", "scan")
    assert len(lines(caplog)) == MOST_PEERS + 1
    assert lines(caplog)[-1] == f"web: {OTHERS}: scan"
    clock.now_s += EVERY_S
    peers.warn("a new one", "scan")
    assert lines(caplog)[-1] == "web: a new one: scan"


def test_what_a_peer_said_is_bounded(peers: PeerLog, caplog: pytest.LogCaptureFixture) -> None:
    peers.warn("a", "x" * 10_000 + "\n")
    [line] = lines(caplog)
    assert len(line) < 250
