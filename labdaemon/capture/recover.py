"""After any interruption, be it a crash or a cancelled step, what was in flight is completed or given up, never lost.

A capture whose exposure was seen to its end is completed from the cameras' cards. One that was not is given up: its
frames are set aside and the shot is repeated, because it is not known what the table did meanwhile.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from labdaemon.capture.acquisition import complete
from labdaemon.capture.collect import clear_card, identity, is_known, store
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.devices import CardFile
from labdaemon.capture.inspect_file import inspect
from labdaemon.capture.own_frames import LIST_S, set_aside, unaccounted_files
from labdaemon.capture.paths import capture_folder, frame_path, set_aside_path
from labdaemon.capture.rig import CALL_S, DeviceHandle
from labdaemon.errors import DeviceError
from labdaemon.imaging.raw_content import Kind
from labdaemon.journal import card_records, records, transitions
from labdaemon.journal.card_records import CardIdentity
from labdaemon.journal.frames import holds, move_new, numbered, remove_parts
from labdaemon.journal.records import CaptureRecord, FrameRecord


async def recover(context: AcquisitionContext) -> None:
    """Settle every capture that is neither stored nor given up.

    Raises
    ------
    DeviceError
        A camera that is needed for it does not answer; call again when it does.
    """
    if not context.partial_files_removed:
        await context.recorder.on_disk(remove_parts, context.data)
        context.partial_files_removed = True
    on_cards = {name: await _list(context, name) for name in context.rig.cameras}
    for name, files in on_cards.items():
        await _match_handles(context, name, files)
    await _clear_stored(context, on_cards)
    for capture in records.captures(context.recorder.journal, None, "intended", "fired", "exposed"):
        if capture.state != "exposed" or not await _complete(context, capture, on_cards):
            await _give_up(context, capture, on_cards)
    for name, files in on_cards.items():
        await _set_aside_leftovers(context, name, files)


async def _list(context: AcquisitionContext, name: str) -> list[CardFile]:
    camera = context.rig.cameras[name]
    return await camera.call(lambda driver: driver.files(), LIST_S + CALL_S)


async def _match_handles(context: AcquisitionContext, name: str, files: list[CardFile]) -> None:
    """Bring what the journal knows of a card in line with it: other handles in a new session, and files that are gone.

    A file with the name and time of one that is gone is another one, and is not taken for it.
    """
    known = card_records.card_files(context.recorder.journal, name)
    listed = {identity(file) for file in files}
    free = listed - known.keys()
    renamed: list[tuple[CardIdentity, CardIdentity]] = []
    gone: list[CardIdentity] = []
    for before in known.keys() - listed:
        same = [file for file in free if before.resembles(file)]
        if len(same) == 1:
            renamed.append((before, same[0]))
            free.discard(same[0])
        elif not same:
            gone.append(before)
    if renamed:
        await context.recorder.write(card_records.rename_handles, name, renamed)
    if gone and (files or await _has_card(context, name)):
        await context.recorder.write(card_records.forget_files, name, gone)


async def _has_card(context: AcquisitionContext, name: str) -> bool:
    """Whether an empty list means an empty card, rather than none that can be read now."""
    status = await context.rig.cameras[name].call(lambda driver: driver.status())
    return bool(status.free_bytes)


async def _clear_stored(context: AcquisitionContext, on_cards: dict[str, list[CardFile]]) -> None:
    """Delete from the cards what a crash kept from being deleted, where the disk's copy is whole."""
    for name, files in on_cards.items():
        known = card_records.card_files(context.recorder.journal, name)
        for file in tuple(files):
            if not known.get(identity(file)):
                continue
            frame = records.frame_of_card(context.recorder.journal, name, identity(file))
            if frame is None:
                continue
            copy = context.data / frame.path
            if await context.recorder.on_disk(holds, copy, frame.size_bytes, frame.sha256):
                await clear_card(context.rig.cameras[name], file, context.recorder)
                files.remove(file)
            else:
                await context.recorder.write(card_records.forget_files, name, [identity(file)])  # fetched once more


async def _complete(context: AcquisitionContext, capture: CaptureRecord, on_cards: dict[str, list[CardFile]]) -> bool:
    """Fetch what is missing of an exposed capture; False if a card no longer has it."""
    stored = {frame.camera: frame for frame in records.frames(context.recorder.journal, capture.campaign, capture.name)}
    for camera in capture.cameras:
        if camera in stored:
            continue
        if camera not in context.rig.cameras:
            return False
        file = _find(on_cards[camera], capture.files.get(camera))
        if file is None:
            return False
        stored[camera] = await store(
            context.rig.cameras[camera],
            file,
            frame_path(context.data, capture, camera, file),
            context.recorder,
            context.clock,
            campaign=capture.campaign,
            capture=capture.name,
        )
        on_cards[camera].remove(file)
    await complete(context, capture, list(stored.values()))
    return True


def _find(files: list[CardFile], wanted: CardIdentity | None) -> CardFile | None:
    """The file of this identity; under another handle where only one is like it, since handles are a session's own."""
    if wanted is None:
        return None
    exact = next((file for file in files if identity(file) == wanted), None)
    same = [file for file in files if wanted.resembles(identity(file))]
    return exact or (same[0] if len(same) == 1 else None)


async def _give_up(context: AcquisitionContext, capture: CaptureRecord, on_cards: dict[str, list[CardFile]]) -> None:
    """Set the capture's frames aside, those on disk and those still on cards."""
    await context.recorder.on_disk(remove_parts, capture_folder(context.data, capture))
    moved: dict[str, str] = {}
    for frame in records.frames(context.recorder.journal, capture.campaign, capture.name):
        if frame.state != "stored":
            continue
        path = set_aside_path(context.data, capture.campaign, capture.name, frame.camera, frame.card_name)
        place = await context.recorder.on_disk(_move_aside, context.data, frame, path)
        moved[frame.path] = str(place.relative_to(context.data))
    for name, files in on_cards.items():
        for file in await unaccounted_files(context.frames, name, files):
            await store(
                context.rig.cameras[name],
                file,
                set_aside_path(context.data, capture.campaign, capture.name, name, file.name),
                context.recorder,
                context.clock,
                campaign=capture.campaign,
                capture=capture.name,
                state="set_aside",
            )
            on_cards[name] = [other for other in on_cards[name] if other.handle != file.handle]
    reason = "interrupted before its exposure was confirmed" if capture.state != "exposed" else "a frame is gone"
    await context.recorder.write(transitions.discard_capture, capture.campaign, capture.name, reason, moved)


def _move_aside(data: Path, frame: FrameRecord, to: Path) -> Path:
    """Move a frame of a capture that is given up; one that a crash left moved, but not journalled, stays there."""
    source = data / frame.path
    if source.exists():
        return move_new(source, to)
    for place in numbered(to):
        if not place.exists():
            return to
        if holds(place, frame.size_bytes, frame.sha256):
            return place
    raise AssertionError("numbers do not end")


async def _set_aside_leftovers(context: AcquisitionContext, name: str, files: list[CardFile]) -> None:
    """Set aside what a capture that was given up is owed; all other files on the card are foreign and stay there.

    A file that is still being written is neither: it is looked at before the next release.
    """
    owed = context.frames.owed(name)
    if owed:
        for file in await unaccounted_files(context.frames, name, files):
            if context.clocks.owner(name, file, owed) is not None:
                await set_aside(context.frames, name, file)
                files = [other for other in files if other.handle != file.handle]
    foreign: list[CardIdentity] = []
    for file in files:
        if file.size_bytes == 0 or is_known(context.recorder, name, file):
            continue
        kind, now = await inspect(context.rig.cameras[name], file) if owed else (Kind.OTHER, file)
        if kind is not Kind.UNFINISHED:
            foreign.append(identity(now))
    if foreign:
        await context.recorder.write(card_records.account_files, name, foreign)


async def reconnect_suspects(context: AcquisitionContext) -> None:
    """Begin anew with every device that has failed; one that answers is no suspect any more.

    Raises
    ------
    DeviceError
        One does not come back. It stays a suspect.
    """
    rig = context.rig
    devices: list[DeviceHandle[Any]] = [*rig.cameras.values(), *rig.gauges]
    devices += [device for device in (rig.trigger, rig.shaker) if device is not None]
    for device in devices:
        name = device.driver.name
        if name not in context.suspect_devices:
            continue
        with suppress(DeviceError):  # it is the new connection that counts
            await device.call(lambda driver: driver.close())
        await device.call(lambda driver: driver.connect(), 2 * CALL_S)
        if device is rig.trigger:
            context.table.enabled = False
        context.exposures_s.pop(name, None)
        context.clocks.invalidate(name)
        context.suspect_devices.discard(name)
