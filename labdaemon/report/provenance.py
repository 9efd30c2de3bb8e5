"""Where results come from: version, calibration, digests of the files that a person wrote and of every photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labdaemon.errors import ConfigError
from labdaemon.file_hash import sha256_of
from labdaemon.processing import NOT_FRAMES
from labdaemon.tomlfile import read_toml
from labdaemon.version import __version__

WRITTEN = ("rig.toml", "control.csv", "targets.csv", "patches.csv", "campaign.toml")
"""Files of a data-set folder that a person wrote."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """What the page says of the origin of its numbers.

    Attributes
    ----------
    facts
        Name and text.
    frames
        Path inside the folder and SHA-256 of each photograph.
    """

    facts: Sequence[tuple[str, str]]
    frames: Sequence[tuple[str, str]]


def provenance(folder: Path) -> Provenance:
    """Collect it; what cannot be read is left out, since the results are there without it."""
    facts = [("labdaemon", __version__)]
    try:
        rig = read_toml(folder / "rig.toml")[1]
    except (ConfigError, OSError):
        rig = {}
    cameras = rig.get("cameras")
    if isinstance(cameras, dict):
        facts += [(f"camera {name}", _lens(about)) for name, about in cameras.items() if isinstance(about, dict)]
    facts += [(name, f"SHA-256 {sha256_of(folder / name)}") for name in WRITTEN if (folder / name).is_file()]
    frames = [
        (path.relative_to(folder).as_posix(), sha256_of(path))
        for base in ("sharp", "captures")
        for path in sorted((folder / base).rglob("*"))
        if path.is_file() and path.suffix.lower() not in NOT_FRAMES and not path.name.startswith(".")
    ]
    return Provenance(facts, frames)


def _lens(about: Mapping[str, Any]) -> str:
    parts = []
    for key, name in (
        ("image_size", "image"),
        ("focal_px", "focal length px"),
        ("principal_point_px", "principal point px"),
        ("distortion", "distortion"),
    ):
        if key in about:
            value = about[key]
            text = ", ".join(f"{one:g}" for one in value) if isinstance(value, list) else f"{value}"
            parts.append(f"{name} {text}")
    return "; ".join(parts) or "not stated"
