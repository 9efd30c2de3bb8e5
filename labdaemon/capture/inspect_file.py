"""Inspects a file on a camera before it is fetched: its size asked anew, and whether its content is RAW."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from labdaemon.capture.devices import Camera, CardFile, FileInspector
from labdaemon.capture.pairing import NOT_RAW_FORMATS, RAW_ENDINGS, ending_of, is_frame
from labdaemon.capture.rig import CALL_S, DeviceHandle
from labdaemon.errors import DataError, DeviceRefused
from labdaemon.imaging.raw_content import Content, Kind, check_content, check_file

REFERENCE_ENDINGS = frozenset({".ndf"})
"""Files that may hold a sensor's values and are yet no frames: Nikon's dust-off references."""


async def inspect(camera: DeviceHandle[Camera], file: CardFile) -> tuple[Kind, CardFile]:
    """What a file on a card is, and what the camera says of it now.

    A driver that cannot look into files leaves format and name to decide.
    """
    if not isinstance(camera.driver, FileInspector):
        return (Kind.RAW if is_frame(file) else Kind.OTHER), file
    if file.format in NOT_RAW_FORMATS and not is_frame(file) and ending_of(file) not in RAW_ENDINGS:
        return Kind.OTHER, file
    return await camera.call(partial(_inspect, file=file), CALL_S)


async def describe(camera: DeviceHandle[Camera], file: CardFile) -> CardFile | None:
    """What the camera says of a file now; None if it is gone."""
    if not isinstance(camera.driver, FileInspector):
        return file
    return await camera.call(partial(_describe, file=file))


def check_fetched(driver: Camera, file: CardFile, path: Path) -> None:
    """Look at what was fetched, before it is believed.

    Raises
    ------
    DataError
        It ends too early: the camera had not written it to its end. Fetching it again helps.
    DeviceRefused
        It is no RAW file.
    """
    if not isinstance(driver, FileInspector):
        return
    kind = _decide(file, check_file(path))
    if kind is Kind.UNFINISHED:
        raise DataError("ends before its own directory says; fetch it again", file=path)
    if kind is Kind.OTHER:
        raise DeviceRefused(f"{file.name} is no RAW file; set its image quality to RAW", device=driver.name)


def _describe(driver: Camera, file: CardFile) -> CardFile | None:
    assert isinstance(driver, FileInspector)
    return driver.describe(file)


def _inspect(driver: Camera, file: CardFile) -> tuple[Kind, CardFile]:
    assert isinstance(driver, FileInspector)
    now = driver.describe(file)
    if now is None or (now.name, now.captured_at) != (file.name, file.captured_at):
        return Kind.OTHER, file  # it is gone; whatever has its handle now is another file
    if now.size_bytes == 0:
        return Kind.UNFINISHED, now
    try:
        content = check_content(partial(driver.read, now), now.size_bytes)
    except DeviceRefused:  # it sends files only whole: looked at once it is fetched
        return (Kind.RAW if is_frame(now) else Kind.OTHER), now
    return _decide(now, content), now


def _decide(file: CardFile, content: Content) -> Kind:
    """Content first; format and name where it says nothing."""
    if ending_of(file) in REFERENCE_ENDINGS:
        return Kind.OTHER
    if content.kind is Kind.UNKNOWN:
        return Kind.RAW if ending_of(file) in RAW_ENDINGS else Kind.OTHER
    return content.kind
