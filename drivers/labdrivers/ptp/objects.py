"""Files on a camera: listing, describing, and fetching them so that a broken transfer is resumed where it broke."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from labdaemon.capture.devices import CardFile
from labdaemon.errors import DeviceRefused, ProtocolError
from labdrivers.ptp.codes import ALL_STORAGES, Op, Response
from labdrivers.ptp.container import DatasetReader
from labdrivers.ptp.datasets import ObjectInfo, StorageInfo
from labdrivers.ptp.session import PtpRefused, PtpSession

BLOCK_BYTES = 1 << 20  # a broken transfer costs no more than this again


def list_handles(session: PtpSession) -> tuple[int, ...]:
    """Handles of all objects on all cards, folders included; none when there is no card."""
    try:
        return DatasetReader(session.call(Op.GET_OBJECT_HANDLES, ALL_STORAGES, 0, 0).data).array("<I")
    except PtpRefused as exc:
        if exc.code == Response.BAD_STORAGE:
            return ()
        raise


def object_info(session: PtpSession, handle: int) -> ObjectInfo | None:
    """Information on a handle's file; None if it is gone."""
    try:
        return ObjectInfo.parse(session.call(Op.GET_OBJECT_INFO, handle).data)
    except PtpRefused as exc:
        if exc.code == Response.BAD_HANDLE:
            return None
        raise


def as_card_file(handle: int, info: ObjectInfo) -> CardFile:
    """A file as the rest of the program knows it."""
    return CardFile(handle, info.name, info.size_bytes, info.captured_at, info.format)


def card_file(session: PtpSession, handle: int) -> CardFile | None:
    """The file behind a handle as the body describes it now; None for a folder, or a handle that is gone."""
    info = object_info(session, handle)
    return None if info is None or info.is_folder else as_card_file(handle, info)


def read_part(session: PtpSession, file: CardFile, offset: int, size: int) -> bytes:
    """Part of a file.

    Raises
    ------
    DeviceRefused
        The camera has no such file, or no partial transfers.
    """
    if not session.supports(Op.GET_PARTIAL_OBJECT):
        raise DeviceRefused("sends files only whole", device=session.device)
    size = max(min(size, file.size_bytes - offset), 0)
    if size == 0:
        return b""
    try:
        return session.call(Op.GET_PARTIAL_OBJECT, file.handle, offset, size).data[:size]
    except PtpRefused as exc:
        if exc.code == Response.BAD_HANDLE:
            raise DeviceRefused(f"has no file {file.name} any more", device=session.device) from exc
        raise


def free_bytes(session: PtpSession) -> int | None:
    """Free space of all cards together, None if the body does not tell."""
    if not session.supports(Op.GET_STORAGE_INFO):
        return None
    ids = DatasetReader(session.call(Op.GET_STORAGE_IDS).data).array("<I")
    cards = [storage for storage in ids if storage & 0xFFFF]  # a zero low half is a slot without a card
    return sum(StorageInfo.parse(session.call(Op.GET_STORAGE_INFO, card).data).free_bytes for card in cards)


def fetch(session: PtpSession, file: CardFile, to: Path) -> None:
    """Append what `to` lacks of a file, block by block; whole, if the body knows no partial transfer.

    Raises
    ------
    DeviceRefused
        The camera has no such file.
    ProtocolError
        It sent more or less than it promised, or has another size or another file now than it promised.
    """
    _must_be_same(session, file)
    have = to.stat().st_size if to.exists() else 0
    if have > file.size_bytes:
        have = 0  # what lies there is something else
    with to.open("r+b" if to.exists() else "xb") as out:
        out.truncate(have)
        out.seek(have)
        try:
            if session.supports(Op.GET_PARTIAL_OBJECT):
                _fetch_blocks(session, file, have, out.write)
            elif have < file.size_bytes:
                out.truncate(0)
                out.seek(0)
                out.write(session.call(Op.GET_OBJECT, file.handle).data)
        except PtpRefused as exc:
            if exc.code == Response.BAD_HANDLE:
                raise DeviceRefused(f"has no file {file.name} any more", device=session.device) from exc
            raise
        finally:
            out.flush()
        if os.fstat(out.fileno()).st_size != file.size_bytes:
            raise ProtocolError(
                f"sent {os.fstat(out.fileno()).st_size} bytes of {file.name}, promised {file.size_bytes}",
                device=session.device,
            )
    _must_be_same(session, file)


def _must_be_same(session: PtpSession, file: CardFile) -> None:
    """A body answers with half the size while it writes, and uses handles again."""
    now = card_file(session, file.handle)
    if now is None:
        raise DeviceRefused(f"has no file {file.name} any more", device=session.device)
    if now != file:
        raise ProtocolError(
            f"has {now.name} of {now.size_bytes} bytes where {file.name} of {file.size_bytes} was",
            device=session.device,
        )


def _fetch_blocks(session: PtpSession, file: CardFile, have: int, write: Callable[[bytes], object]) -> None:
    while have < file.size_bytes:
        asked = min(BLOCK_BYTES, file.size_bytes - have)
        block = session.call(Op.GET_PARTIAL_OBJECT, file.handle, have, asked).data
        if not 0 < len(block) <= asked:
            raise ProtocolError(
                f"sent {len(block)} bytes where {asked} of {file.name} were asked for", device=session.device
            )
        write(block)
        have += len(block)
