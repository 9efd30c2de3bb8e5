"""Give up a capture that is stored: its frames are set aside, never lost, and the shot is taken again."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from labdaemon.capture.paths import capture_folder, set_aside_path
from labdaemon.capture.recorder import Recorder
from labdaemon.durable import move_durably
from labdaemon.journal import records, transitions
from labdaemon.journal.records import CaptureRecord


async def discard_stored(recorder: Recorder, data: Path, capture: CaptureRecord, reason: str) -> None:
    """Set a stored capture's frames aside and note why.

    Raises
    ------
    StorageError
        The disk does not take it.
    """
    moved: dict[str, str] = {}
    for frame in records.frames(recorder.journal, capture.campaign, capture.name):
        path = set_aside_path(data, capture.campaign, capture.name, frame.camera, frame.card_name)
        await recorder.on_disk(_move, data / frame.path, path)
        moved[frame.path] = str(path.relative_to(data))
    if not capture.is_sharp:
        await recorder.on_disk(_remove_folder, capture_folder(data, capture))
    await recorder.write(transitions.discard_capture, capture.campaign, capture.name, reason, moved)


def _move(path: Path, to: Path) -> None:
    if path.exists():
        move_durably(path, to)


def _remove_folder(folder: Path) -> None:
    """Without its frames a capture's folder would only keep `labdaemon process` from the others."""
    with suppress(OSError):  # what a person has put there stays
        (folder / "capture.toml").unlink(missing_ok=True)
        folder.rmdir()
