from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from labdaemon.testing import free_port as module
from labdaemon.testing.free_port import COUNT, FIRST, free_port


def test_ports_are_given_once_and_not_to_outgoing_connections() -> None:
    ports = [free_port() for _ in range(50)]
    assert len(set(ports)) == 50
    lowest_outgoing = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    assert FIRST <= min(ports) <= max(ports) < min(FIRST + COUNT, lowest_outgoing)


def test_a_port_that_is_taken_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port()))
        taken.listen()
        port = taken.getsockname()[1]
        monkeypatch.setattr(module, "FIRST", port)
        monkeypatch.setattr(module, "COUNT", 1)
        with pytest.raises(OSError, match=f"no port of {port} to {port} is free"):
            free_port()


def test_two_processes_begin_at_different_places() -> None:
    code = "from labdaemon.testing.free_port import free_port; print(free_port())"
    ports = {subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout for _ in range(2)}
    assert len(ports) == 2
