from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.service.watchdog import feed, notify, watchdog_period_s


@pytest.mark.parametrize("abstract", [False, True])
def test_states_reach_systemd(tmp_path: Path, abstract: bool):
    name = f"@labdaemon-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind("\0" + name[1:] if abstract else name)
        assert notify("READY=1\nSTATUS=serving", {"NOTIFY_SOCKET": name})
        assert server.recv(100) == b"READY=1\nSTATUS=serving"


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "nowhere"}, {"NOTIFY_SOCKET": "/nowhere/at/all"}])
def test_without_systemd_nothing_is_sent_and_nothing_fails(environment: dict[str, str]):
    assert not notify("READY=1", environment)


def test_the_period_is_half_of_what_systemd_asks_for():
    assert watchdog_period_s({"WATCHDOG_USEC": "60000000"}) == 30.0
    assert watchdog_period_s({"WATCHDOG_USEC": "60000000", "WATCHDOG_PID": "1"}) is None
    assert watchdog_period_s({"WATCHDOG_USEC": "soon"}) is None
    assert watchdog_period_s({}) is None


def test_it_is_fed_only_while_everything_advances():
    clock = SimulatedClock()
    moving = {"journal": True, "guard": True}
    fed: list[float] = []
    behind: list[list[str]] = []

    def check(name: str):
        async def advanced() -> bool:
            return moving[name]

        return advanced

    async def main() -> None:
        checks = {name: check(name) for name in moving}

        def send(message: str) -> bool:
            assert message == "WATCHDOG=1"
            fed.append(clock.monotonic())
            return True

        feeding = asyncio.create_task(feed(clock, checks, behind.append, send, 10.0))
        await clock.sleep(25.0)
        moving["guard"] = False
        await clock.sleep(20.0)
        moving["guard"] = True
        await clock.sleep(10.0)
        feeding.cancel()

    clock.run(main())
    assert fed == [0.0, 10.0, 20.0, 50.0]
    assert behind == [["guard"], ["guard"]]


def test_a_check_that_never_returns_starves_it():
    clock = SimulatedClock()
    fed: list[str] = []

    async def main() -> None:
        async def stuck() -> bool:
            await clock.sleep(1e6)
            return True

        def send(message: str) -> bool:
            fed.append(message)
            return True

        feeding = asyncio.create_task(feed(clock, {"journal": stuck}, lambda names: None, send, 10.0))
        await clock.sleep(1000.0)
        feeding.cancel()

    clock.run(main())
    assert fed == []
