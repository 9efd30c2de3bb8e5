"""One line a peer and minute, and bounded memory for peers."""

from __future__ import annotations

import logging

import pytest

from labdaemon.stream import peer_log
from labdaemon.stream.peer_log import EVERY_S, MOST_PEERS, PeerLog

log = logging.getLogger("test")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [1000.0]
    monkeypatch.setattr(peer_log.time, "monotonic", lambda: now[0])
    return now


def test_a_peer_has_a_line_a_minute_and_the_next_one_counts(clock: list[float], caplog: pytest.LogCaptureFixture):
    peers = PeerLog(log, "web")
    for _ in range(1000):
        peers.warn("10.0.0.1", "no request")
    peers.warn("10.0.0.2", "another\npeer\ud800")
    assert [record.getMessage() for record in caplog.records] == [
        "web: 10.0.0.1: no request",
        "web: 10.0.0.2: another\npeer\\ud800",
    ]
    clock[0] += EVERY_S
    peers.warn("10.0.0.1", "no request")
    assert caplog.records[-1].getMessage() == "web: 10.0.0.1: no request (999 more times since the last line)"


def test_many_peers_share_a_line(clock: list[float], caplog: pytest.LogCaptureFixture):
    peers = PeerLog(log, "web")
    for place in range(10 * MOST_PEERS):
        peers.warn(f"10.0.{place // 256}.{place % 256}", "no request")
    assert len(caplog.records) == MOST_PEERS + 1
    assert "other peers" in caplog.records[-1].getMessage()
    clock[0] += EVERY_S
    peers.warn("fresh", "no request")
    assert caplog.records[-1].getMessage().startswith("web: fresh: ")
    assert len(peers._last) <= MOST_PEERS + 1
