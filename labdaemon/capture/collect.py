"""A camera's file on its way to the disk: waited for, fetched as ``.part``, sealed, journalled, cleared from the card.

The card's copy goes only after the disk's is synced under a name that nothing replaces, its size and SHA-256 are in the
journal, and the camera, asked once more, still has the same file of the same size.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from labdaemon.capture.devices import Camera, CardFile
from labdaemon.capture.inspect_file import check_fetched, describe, inspect
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import CALL_S, DeviceHandle
from labdaemon.clock import Clock
from labdaemon.durable import PART, storage_error
from labdaemon.errors import DataError, DeviceError, DeviceRefused, StorageUnavailable
from labdaemon.imaging.raw_content import Kind
from labdaemon.journal import card_records, transitions
from labdaemon.journal.card_records import CardIdentity
from labdaemon.journal.frames import part_of, seal_new
from labdaemon.journal.records import FrameRecord, FrameState

SLICE_S = 1.0
"""Longest single wait on a camera, so that a stop or a heartbeat on its line is not held up."""

UNFINISHED_SLICE_S = 0.25
"""The same while a file is still being written."""

SLOWEST_BYTES_S = 500_000.0
"""A transfer slower than this has failed (the slowest bodies reach a few megabytes a second)."""

FETCH_TRIES = 4  # transfers break where a cable is bad; each try begins where the last one broke


def identity(file: CardFile) -> CardIdentity:
    """What the journal knows a file by."""
    return CardIdentity(file.name, file.captured_at, file.handle, file.size_bytes)


def is_known(recorder: Recorder, camera: str, file: CardFile) -> bool:
    """Whether a file on a card was copied before, or is none of ours."""
    return card_records.is_accounted(recorder.journal, camera, identity(file))


async def wait_frame(
    camera: DeviceHandle[Camera],
    recorder: Recorder,
    clock: Clock,
    timeout_s: float,
    unfinished: list[CardFile] | None = None,
) -> CardFile | None:
    """The next RAW file that is new to the journal and written to its end; None when none came in time.

    `unfinished` are files that came earlier and are not decided yet; it is kept up, for the next call.
    """
    name, end_s = camera.driver.name, clock.monotonic() + timeout_s
    waiting = [] if unfinished is None else unfinished
    while True:
        longest_s = UNFINISHED_SLICE_S if waiting else SLICE_S
        slice_s = min(longest_s, max(end_s - clock.monotonic(), 0.0))
        file = await camera.call(partial(_wait_file, timeout_s=slice_s), slice_s + CALL_S)
        if file is not None and not is_known(recorder, name, file):
            waiting.append(file)
        for candidate in tuple(waiting):
            kind, now = await inspect(camera, candidate)
            if kind is not Kind.UNFINISHED:
                waiting.remove(candidate)
            if kind is Kind.RAW and not is_known(recorder, name, now):
                return now
        if file is None and clock.monotonic() >= end_s:
            return None


def _wait_file(driver: Camera, timeout_s: float) -> CardFile | None:
    return driver.wait_file(timeout_s)


async def store(
    camera: DeviceHandle[Camera],
    file: CardFile,
    path: Path,
    recorder: Recorder,
    clock: Clock,
    *,
    campaign: str,
    capture: str,
    state: FrameState = "stored",
) -> FrameRecord:
    """Bring one file from a card to `path`, for good; to a name next to it where that is another frame's.

    Raises
    ------
    DeviceError
        The camera failed more often than a bad wire explains. The card still has the file.
    DataError
        The disk refused it. `StorageUnavailable` if it may take it later.
    """
    name = camera.driver.name
    file, path, size_bytes, sha256 = await _fetch(camera, file, path, recorder, clock)
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
    await recorder.write(transitions.store_frame, frame, identity(file))
    await clear_card(camera, file, recorder)
    return frame


async def clear_card(camera: DeviceHandle[Camera], file: CardFile, recorder: Recorder) -> None:
    """Delete a stored frame from the card and forget it; one that cannot be deleted now is, by the next recovery."""
    try:
        await camera.call(lambda driver: driver.delete(file))
    except DeviceError:  # the copy is safe, and the next recovery clears the card
        return
    await recorder.write(card_records.forget_files, camera.driver.name, [identity(file)])


async def _fetch(
    camera: DeviceHandle[Camera], file: CardFile, path: Path, recorder: Recorder, clock: Clock
) -> tuple[CardFile, Path, int, str]:
    """Download and seal on the camera's own thread, from where a broken transfer broke.

    Returns
    -------
    The file as the camera described it last, where it lies, its size in bytes and its SHA-256.
    """
    part = path.with_name(path.name + PART)

    def fetch(driver: Camera, file: CardFile) -> tuple[Path, int, str]:
        try:
            driver.download(file, part)
            check_fetched(driver, file, part)
        except OSError as exc:
            raise storage_error(exc, path) from exc
        return seal_new(path, file.size_bytes if 0 < file.size_bytes < 0xFFFFFFFF else None)

    await recorder.on_disk(_remove_part, path)
    for attempt in range(1, FETCH_TRIES + 1):
        try:
            now = await describe(camera, file)
            if now is None or (now.name, now.captured_at) != (file.name, file.captured_at):
                raise DeviceRefused(f"has no file {file.name} any more", device=camera.driver.name)
            if now != file:
                await recorder.on_disk(_remove_part, path)  # it was fetched while the camera still wrote it
                file = now
            if file.size_bytes == 0:
                raise DataError("has 0 bytes: the camera has not written it yet", file=file.name)
            deadline_s = CALL_S + file.size_bytes / SLOWEST_BYTES_S
            return file, *await camera.call(partial(fetch, file=file), deadline_s)
        except StorageUnavailable:
            await recorder.on_disk(_remove_part, path)
            raise
        except (DeviceError, DataError) as exc:
            if attempt == FETCH_TRIES or not (exc.retryable or isinstance(exc, DataError)):
                raise
            if isinstance(exc, DataError):
                await recorder.on_disk(_remove_part, path)
            await clock.sleep(0.5 * 2.0**attempt)
            if isinstance(exc, DeviceError):
                await reconnect(camera)
    raise AssertionError("the loop returns or raises")


def _remove_part(path: Path) -> None:
    part_of(path).unlink(missing_ok=True)


async def reconnect(camera: DeviceHandle[Camera]) -> None:
    """End a camera's session and begin another; what does not work out shows at the next call."""
    try:
        await camera.call(lambda driver: driver.close())
        await camera.call(lambda driver: driver.connect())
    except DeviceError:  # the next call of the camera reports it
        return
