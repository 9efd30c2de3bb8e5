"""The data disk: room, an answer in time, and the right words when there is none."""

from __future__ import annotations

import asyncio
import errno
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.disk import ANSWER_S, DataDisk
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import SimulatedClock
from labdaemon.errors import StorageFull, StorageUnavailable
from labdaemon.journal.journal import Journal

LEAST = 1_000_000


class Disk:
    """Room that a test sets; an `OSError` is raised instead."""

    def __init__(self, recorder: Recorder) -> None:
        self.room: int | OSError = 10 * LEAST
        self.asked = DataDisk(recorder, self._free, LEAST)

    def _free(self) -> int:
        if isinstance(self.room, OSError):
            raise self.room
        return self.room


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def disk(tmp_path: Path, clock: SimulatedClock) -> Iterator[Disk]:
    journal = Journal(tmp_path, clock, synchronous="OFF")
    yield Disk(Recorder(journal, InlineExecutor("journal", lambda: 0.0)))
    journal.close()


def test_a_disk_with_room_is_fine(disk: Disk, clock: SimulatedClock) -> None:
    async def scenario() -> None:
        await disk.asked.check()
        await disk.asked.check_thoroughly()

    clock.run(scenario())


def test_the_least_room_is_enough_and_a_byte_less_is_not(disk: Disk, clock: SimulatedClock) -> None:
    disk.room = LEAST
    clock.run(disk.asked.check())
    disk.room = LEAST - 1
    with pytest.raises(StorageFull, match="1 MB free, less than 1 MB"):
        clock.run(disk.asked.check())


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOTCONN, errno.EACCES])
def test_whatever_the_disk_raises_may_pass(disk: Disk, clock: SimulatedClock, number: int) -> None:
    """A share that is gone for a minute must pause the campaign, not end the daemon."""
    disk.room = OSError(number, "no answer")
    for check in (disk.asked.check, disk.asked.check_thoroughly):
        with pytest.raises(StorageUnavailable):
            clock.run(check())


def test_a_disk_that_does_not_answer_is_given_up_in_time(
    disk: Disk, clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def never(*_: Any, **__: Any) -> None:
        await asyncio.sleep(1e6)

    monkeypatch.setattr(Recorder, "write", never)
    with pytest.raises(StorageUnavailable, match=f"has not answered for {ANSWER_S:g} s"):
        clock.run(disk.asked.check())
    assert clock.monotonic() == pytest.approx(ANSWER_S)
