"""Commands that arrive before the daemon can carry them out."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError
from labdaemon.journal import transitions
from labdaemon.journal.journal import Journal
from labdaemon.service.deferred_commands import METHODS, PATIENCE_S, DeferredCommands
from labdaemon.stream.messages import WrongStateError


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path, SimulatedClock(), synchronous="OFF")
    yield journal
    journal.close()


def answering(word: str) -> Any:
    async def handler(params: dict[str, Any]) -> Any:
        return {"by": word, **params}

    return dict.fromkeys(METHODS, handler)


def test_a_command_waits_for_the_daemon_to_have_started(journal: Journal) -> None:
    commands, clock = DeferredCommands(), SimulatedClock()

    async def scenario() -> Any:
        asked = asyncio.create_task(commands.handlers()["campaign.submit"]({"toml": "x"}))
        await asyncio.sleep(PATIENCE_S - 1.0)
        assert not asked.done()
        commands.serve(answering("engine"), journal)
        return await asked

    assert clock.run(scenario()) == {"by": "engine", "toml": "x"}


def test_what_needs_no_devices_is_carried_out_at_once(journal: Journal) -> None:
    """Above all the stop: it must not wait for a camera."""
    commands, clock = DeferredCommands(), SimulatedClock()
    commands.serve_early({"stop": answering("early")["stop"]})

    async def scenario() -> None:
        assert await commands.handlers()["stop"]({}) == {"by": "early"}
        assert clock.monotonic() == 0.0
        commands.serve(answering("engine"), journal)
        assert await commands.handlers()["stop"]({}) == {"by": "engine"}

    clock.run(scenario())


@pytest.mark.parametrize("refusal", [None, DeviceError("no answer", device="left")])
def test_patience_ends_with_why_it_cannot_be_done(refusal: DeviceError | None) -> None:
    commands, clock = DeferredCommands(), SimulatedClock()
    commands.serve_early({}, (lambda: refusal) if refusal is not None else None)
    expected, words = (DeviceError, "left: no answer") if refusal else (WrongStateError, "the daemon is starting")
    with pytest.raises(expected, match=words):
        clock.run(commands.handlers()["capture"]({}))
    assert clock.monotonic() == pytest.approx(PATIENCE_S)


def test_replies_to_earlier_requests_come_from_the_journal(journal: Journal) -> None:
    commands = DeferredCommands()
    assert commands.answer("r1") is None
    id = transitions.submit(journal, "night", "", "", "r1")
    commands.serve(answering("engine"), journal)
    assert commands.answer("r1") == {"campaign": id}
    commands.keep("r2", {"campaign": "x"})
    assert commands.answer("r2") is None, "handlers keep replies in the journal, with the change itself"
