"""The disk that holds journal and campaigns: whether it takes what must be written."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from labdaemon.capture.recorder import Recorder
from labdaemon.durable import storage_error
from labdaemon.errors import StorageFull, StorageUnavailable
from labdaemon.journal import transitions
from labdaemon.journal.storage import probe_disk

ANSWER_S = 10.0
"""A disk that has not taken a commit in this time is not waited for with the table moving."""


class DataDisk:
    """Asks the data disk.

    Parameters
    ----------
    recorder
        The journal.
    free_bytes
        Room on the disk; blocks.
    min_free_bytes
        Room that there must be while a campaign runs.
    """

    def __init__(self, recorder: Recorder, free_bytes: Callable[[], int], min_free_bytes: int) -> None:
        self._recorder = recorder
        self._free_bytes, self._min_free_bytes = free_bytes, min_free_bytes

    async def check(self) -> None:
        """Show that there is room and that the journal takes a commit, soon.

        Raises
        ------
        StorageUnavailable
            There is not, or it does not.
        JournalError
            Another disk lies where the journal's was.
        """
        try:
            async with asyncio.timeout(ANSWER_S):
                await self._check_room()
                await self._recorder.write(transitions.probe)
        except TimeoutError:
            raise StorageUnavailable(
                f"has not answered for {ANSWER_S:g} s; check the disk", file=self._recorder.journal.folder
            ) from None

    async def check_thoroughly(self) -> None:
        """Show that the disk takes whole files too, however long that takes: free space says nothing of quotas.

        Raises
        ------
        StorageError
            It does not.
        """
        await self._check_room()
        await self._recorder.on_disk(probe_disk, self._recorder.journal.path)
        await self._recorder.write(transitions.probe)

    async def _check_room(self) -> None:
        try:
            await self._recorder.on_disk(self._recorder.journal.check_place)
            free = await self._recorder.on_disk(self._free_bytes)
        except OSError as exc:
            cause = storage_error(exc, self._recorder.journal.folder)
            raise cause if isinstance(cause, StorageUnavailable) else StorageUnavailable(str(cause)) from exc
        if free < self._min_free_bytes:
            raise StorageFull(
                f"{free / 1e6:.0f} MB free, less than {self._min_free_bytes / 1e6:.0f} MB; free some space",
                file=self._recorder.journal.folder,
            )
