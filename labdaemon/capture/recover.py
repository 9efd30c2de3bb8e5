"""After any interruption, a crash or a cancelled step alike: what was in flight is completed or given up, never lost.

A capture whose exposure was seen to its end is completed from the cameras' cards. One that was not is given up: its
frames are set aside and the shot is repeated, because nobody knows what the table did meanwhile.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from labdaemon.capture.capture import Lab, complete
from labdaemon.capture.collect import clear_card, is_known, store
from labdaemon.capture.devices import CardFile
from labdaemon.capture.pairing import is_frame
from labdaemon.capture.places import capture_folder, frame_path, set_aside_path
from labdaemon.capture.rig import CALL_S, Wired
from labdaemon.durable import move_durably
from labdaemon.errors import DeviceError
from labdaemon.journal import records, transitions
from labdaemon.journal.frames import remove_parts
from labdaemon.journal.records import CaptureRecord

LIST_S = 60.0
"""A card with thousands of foreign pictures takes a while to list."""


async def recover(lab: Lab) -> None:
    """Settle every capture that is neither stored nor given up.

    Raises
    ------
    DeviceError
        A camera that is needed for it does not answer; call again when it does.
    """
    if not lab.swept:
        await lab.recorder.on_disk(remove_parts, lab.data)
        lab.swept = True
    on_cards = {name: await _list(lab, name) for name in lab.rig.cameras}
    await _clear_stored(lab, on_cards)
    for capture in records.captures(lab.recorder.journal, None, "intended", "fired", "exposed"):
        if capture.state != "exposed" or not await _complete(lab, capture, on_cards):
            await _give_up(lab, capture, on_cards)
    await _leave_alone(lab, on_cards)


async def _list(lab: Lab, name: str) -> list[CardFile]:
    camera = lab.rig.cameras[name]
    files = await camera.call(lambda driver: driver.files(), LIST_S + CALL_S)
    return [file for file in files if is_frame(file)]


async def _clear_stored(lab: Lab, on_cards: dict[str, list[CardFile]]) -> None:
    """Delete from the cards what a crash kept from being deleted, where the disk's copy is whole."""
    for name, files in on_cards.items():
        for file in files:
            frame = records.frame_of_card(lab.recorder.journal, name, file.name, file.captured_at)
            if frame is None or not frame.capture:
                continue
            if await lab.recorder.on_disk(_has_size, lab.data / frame.path, frame.size_bytes):
                await clear_card(lab.rig.cameras[name], file)


async def _complete(lab: Lab, capture: CaptureRecord, on_cards: dict[str, list[CardFile]]) -> bool:
    """Fetch what is missing of an exposed capture; False if a card no longer has it."""
    stored = {frame.camera: frame for frame in records.frames(lab.recorder.journal, capture.campaign, capture.name)}
    for camera in capture.cameras:
        if camera in stored:
            continue
        if camera not in lab.rig.cameras:
            return False
        wanted = capture.files.get(camera)
        file = next((file for file in on_cards[camera] if (file.name, file.captured_at) == wanted), None)
        if file is None:
            return False
        stored[camera] = await store(
            lab.rig.cameras[camera],
            file,
            frame_path(lab.data, capture, camera, file),
            lab.recorder,
            lab.clock,
            campaign=capture.campaign,
            capture=capture.name,
        )
    await complete(lab, capture, list(stored.values()))
    return True


async def _give_up(lab: Lab, capture: CaptureRecord, on_cards: dict[str, list[CardFile]]) -> None:
    """Set the capture's frames aside, those on disk and those still on cards."""
    await lab.recorder.on_disk(remove_parts, capture_folder(lab.data, capture))
    moved: dict[str, str] = {}
    for frame in records.frames(lab.recorder.journal, capture.campaign, capture.name):
        path = set_aside_path(lab.data, capture.campaign, capture.name, frame.camera, frame.card_name)
        if frame.state == "stored":
            await lab.recorder.on_disk(_move_if_there, lab.data / frame.path, path)
        moved[frame.path] = str(path.relative_to(lab.data))
    for name, files in on_cards.items():
        for file in files:
            if is_known(lab.recorder, name, file):
                continue
            path = set_aside_path(lab.data, capture.campaign, capture.name, name, file.name)
            await store(
                lab.rig.cameras[name],
                file,
                path,
                lab.recorder,
                lab.clock,
                campaign=capture.campaign,
                capture=capture.name,
                state="set_aside",
            )
    reason = "interrupted before its exposure was confirmed" if capture.state != "exposed" else "a frame is gone"
    await lab.recorder.write(transitions.discard_capture, capture.campaign, capture.name, reason, moved)


def _has_size(path: Path, size_bytes: int) -> bool:
    return path.is_file() and path.stat().st_size == size_bytes


def _move_if_there(path: Path, to: Path) -> None:
    if path.exists():
        move_durably(path, to)


async def _leave_alone(lab: Lab, on_cards: dict[str, list[CardFile]]) -> None:
    """Remember files that no capture of ours explains: they are somebody else's."""
    for name, files in on_cards.items():
        foreign = [(file.name, file.captured_at) for file in files if not is_known(lab.recorder, name, file)]
        if foreign:
            await lab.recorder.write(transitions.know_files, name, foreign)


async def reconnect_suspects(lab: Lab) -> None:
    """Begin anew with every device that a fault was put down to; one that answers is no suspect any more.

    Raises
    ------
    DeviceError
        One does not come back. It stays a suspect.
    """
    rig = lab.rig
    devices: list[Wired[Any]] = [*rig.cameras.values(), *rig.gauges]
    devices += [device for device in (rig.trigger, rig.shaker) if device is not None]
    for device in devices:
        name = device.driver.name
        if name not in lab.suspects:
            continue
        with suppress(DeviceError):  # it is the new connection that counts
            await device.call(lambda driver: driver.close())
        await device.call(lambda driver: driver.connect(), 2 * CALL_S)
        if device is rig.trigger:
            lab.table.enabled = False
        lab.exposures_s.pop(name, None)
        lab.clocks.forget(name)
        lab.suspects.discard(name)
