"""Whether the frames that bodies deliver have the size that the rig file says: seen at the first of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from labdaemon.errors import ConfigError, DataError, SetupError
from labdaemon.imaging import read_frame
from labdaemon.processing.rigfile import read_rig


def check_frame_sizes(folder: Path, frames: Sequence[tuple[str, Path]]) -> None:
    """Compare the first frames of a campaign with the rig file of its folder; one task for a worker.

    Parameters
    ----------
    folder
        The data-set folder.
    frames
        Camera and file of each. One that cannot be read is not judged: measuring reports it.

    Raises
    ------
    SetupError
        A frame has another size: no capture of this campaign could be measured.
    """
    try:
        cameras = read_rig(folder / "rig.toml").cameras
    except ConfigError:
        return  # measuring says what is wrong with it
    for camera, path in frames:
        try:
            width, height = read_frame(path).size
        except DataError:  # measuring names the frame that cannot be read
            continue
        stated = cameras[camera].image_size if camera in cameras else (width, height)
        if (width, height) != tuple(stated):
            raise SetupError(
                f"camera {camera} delivers {width}x{height} pixels, but image_size says {stated[0]}x{stated[1]}: set "
                "it to LibRaw's visible RAW area (not the JPEG's) with the lens calibrated for it, or mend the "
                "body's own setting; the frame is set aside"
            )
