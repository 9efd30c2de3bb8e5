"""A campaign's folder, made before its first frame: a data-set folder that `labdaemon process` takes as it is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from labdaemon.capture.places import campaign_folder
from labdaemon.durable import write_durably


def prepare_folder(data: Path, campaign: str, files: Mapping[str, str]) -> Path:
    """Make the folder with these files (name to text) in it; files that are there already stay as they are.

    Raises
    ------
    DataError
        The disk is full or cannot be written.
    """
    folder = campaign_folder(data, campaign)
    for name, text in files.items():
        if not (folder / name).exists():
            write_durably(folder / name, text)
    return folder
