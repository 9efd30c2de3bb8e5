"""A camera's file on its way to the disk: waited for, fetched as ``.part``, sealed, journalled, cleared from the card.

The card's copy goes only after the disk's is synced and its size and SHA-256 are in the journal.
"""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path

from labdaemon.capture.devices import Camera, CardFile
from labdaemon.capture.pairing import is_frame
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import CALL_S, Rig, Wired
from labdaemon.clock import Clock
from labdaemon.durable import storage_error
from labdaemon.errors import DataError, DeviceError, StorageUnavailable, TransportError
from labdaemon.journal import records, transitions
from labdaemon.journal.frames import part_of, seal
from labdaemon.journal.records import FrameRecord, FrameState

SLICE_S = 1.0
"""Longest single wait on a camera, so that a stop or a heartbeat on its line is not held up."""

SLOWEST_BYTES_S = 500_000.0
"""A transfer slower than this has failed (the slowest bodies reach a few megabytes a second)."""

FETCH_TRIES = 4


def is_known(recorder: Recorder, camera: str, file: CardFile) -> bool:
    """Whether a file on a card was copied before, or is none of ours."""
    if records.frame_of_card(recorder.journal, camera, file.name, file.captured_at) is not None:
        return True
    return (file.name, file.captured_at) in records.known_files(recorder.journal, camera)


async def wait_frame(camera: Wired[Camera], recorder: Recorder, clock: Clock, timeout_s: float) -> CardFile | None:
    """The next RAW file that is new to the journal; None when none came in time."""
    name, end_s = camera.driver.name, clock.monotonic() + timeout_s
    while True:
        slice_s = min(SLICE_S, max(end_s - clock.monotonic(), 0.0))
        file = await camera.call(partial(_wait_file, timeout_s=slice_s), slice_s + CALL_S)
        if file is not None and is_frame(file) and not is_known(recorder, name, file):
            return file
        if file is None and clock.monotonic() >= end_s:
            return None


def _wait_file(driver: Camera, timeout_s: float) -> CardFile | None:
    return driver.wait_file(timeout_s)


async def wait_all(rig: Rig, recorder: Recorder, clock: Clock, timeout_s: float) -> dict[str, CardFile]:
    """One new file from every camera.

    Raises
    ------
    TransportError
        A camera delivered none in time: it is lost, out of power, or was not released.
    """
    files = await asyncio.gather(*(wait_frame(camera, recorder, clock, timeout_s) for camera in rig.cameras.values()))
    arrived: dict[str, CardFile] = {}
    for name, file in zip(rig.cameras, files, strict=True):
        if file is None:
            raise TransportError(
                f"no frame within {timeout_s:g} s of the release; check cable, power and shutter lead", device=name
            )
        arrived[name] = file
    return arrived


async def store(
    camera: Wired[Camera],
    file: CardFile,
    path: Path,
    recorder: Recorder,
    clock: Clock,
    *,
    campaign: str,
    capture: str,
    state: FrameState = "stored",
) -> FrameRecord:
    """Bring one file from a card to `path`, for good.

    Raises
    ------
    DeviceError
        The camera failed more often than can be put down to the wire. The card still has the file.
    DataError
        The disk refused it. `StorageUnavailable` if it may take it later.
    """
    name = camera.driver.name
    size_bytes, sha256 = await _fetch(camera, file, path, recorder, clock)
    frame = FrameRecord(
        campaign,
        capture,
        name,
        str(path.relative_to(recorder.journal.folder)),
        file.name,
        file.captured_at,
        size_bytes,
        sha256,
        state,
    )
    await recorder.write(transitions.store_frame, frame)
    await clear_card(camera, file)
    return frame


async def clear_card(camera: Wired[Camera], file: CardFile) -> None:
    """Delete a stored frame from the card; one that cannot be deleted now is, by the next recovery."""
    try:
        await camera.call(lambda driver: driver.delete(file))
    except DeviceError:
        return


async def _fetch(
    camera: Wired[Camera], file: CardFile, path: Path, recorder: Recorder, clock: Clock
) -> tuple[int, str]:
    """Download and seal on the camera's own thread, going on after a broken transfer where it broke."""
    deadline_s = CALL_S + file.size_bytes / SLOWEST_BYTES_S
    size_bytes = file.size_bytes if 0 < file.size_bytes < 0xFFFFFFFF else None

    def fetch(driver: Camera) -> tuple[int, str]:
        try:
            driver.download(file, part_of(path))
        except OSError as exc:
            raise storage_error(exc, path) from exc
        return seal(path, size_bytes)

    await recorder.on_disk(_remove_part, path)
    for attempt in range(1, FETCH_TRIES + 1):
        try:
            return await camera.call(fetch, deadline_s)
        except StorageUnavailable:
            await recorder.on_disk(_remove_part, path)
            raise
        except (DeviceError, DataError) as exc:
            if attempt == FETCH_TRIES or not (exc.retryable or isinstance(exc, DataError)):
                raise
            await clock.sleep(0.5 * 2.0**attempt)
            await reconnect(camera)
    raise AssertionError("the loop returns or raises")


def _remove_part(path: Path) -> None:
    part_of(path).unlink(missing_ok=True)


async def reconnect(camera: Wired[Camera]) -> None:
    """End a camera's session and begin another; what does not work out shows at the next call."""
    try:
        await camera.call(lambda driver: driver.close())
        await camera.call(lambda driver: driver.connect())
    except DeviceError:
        return
