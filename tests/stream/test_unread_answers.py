"""Large answers that are not read: one client's and everybody's are bounded, and given back when they are taken."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import pytest

from labdaemon.stream import unread_answers
from labdaemon.stream.unread_answers import MOST_OF_ALL, MOST_OF_ONE, UnreadAnswers


@dataclass
class Tracked:
    done: bool = False


def test_one_client_and_all_of_them_are_bounded():
    answers = UnreadAnswers()
    first = Tracked()
    answers.add(b"a", MOST_OF_ONE, first)
    assert not answers.has_room(b"a")
    assert answers.has_room(b"b")
    first.done = True
    assert answers.has_room(b"a")
    for number in range(MOST_OF_ALL // MOST_OF_ONE):
        answers.add(bytes([number]), MOST_OF_ONE, Tracked())
    assert not answers.has_room(b"new")


def test_who_reads_is_waited_for_and_who_does_not_is_refused(monkeypatch: pytest.MonkeyPatch):
    async def main() -> None:
        answers, held = UnreadAnswers(), Tracked()
        answers.add(b"a", MOST_OF_ONE, held)
        waiting = asyncio.create_task(answers.wait_for_room(b"a"))
        await asyncio.sleep(0.03)
        assert not waiting.done()
        held.done = True
        assert await waiting
        monkeypatch.setattr(unread_answers, "PATIENCE_S", 0.05)
        answers.add(b"a", MOST_OF_ONE, Tracked())
        assert not await answers.wait_for_room(b"a")

    asyncio.run(main())
