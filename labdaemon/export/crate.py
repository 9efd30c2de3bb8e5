"""RO-Crate 1.1: `ro-crate-metadata.json` at the root of a data-set folder says what each file is, with its SHA-256.

`labdaemon verify` compares the files with it. Specification: https://w3id.org/ro/crate/1.1.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from labdaemon.analysis.verification import CRATE
from labdaemon.clock import rfc3339
from labdaemon.export.results import FolderResults
from labdaemon.file_hash import sha256_of
from labdaemon.version import __version__

PROJECT = "labdaemon"
MEDIA_TYPES = {
    ".csv": "text/csv",
    ".toml": "application/toml",
    ".html": "text/html",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".dng": "image/x-adobe-dng",
    ".nef": "image/x-nikon-nef",
    ".tif": "image/tiff",
    ".tiff": "image/tiff",
    ".h5": "application/x-hdf5",
    ".nc": "application/x-netcdf",
    ".parquet": "application/vnd.apache.parquet",
}
DESCRIBED = {
    "rig.toml": "cameras, target size and control of the rig",
    "control.csv": "surveyed control targets, mm",
    "targets.csv": "approximate places of the monitoring targets, mm",
    "patches.csv": "textured patches in the sharp frames, px",
    "campaign.toml": "the campaign as it was submitted",
    "envelope.csv": "vibration envelopes: position and motion of every target, mm, with sd and flags",
    "measurements.csv": "motion of every target in every photograph, px",
    "gauges.csv": "amplitude and phase of every gauge in each capture",
    "capture.toml": "excitation, exposure and light of a capture",
}
"""File names and what is in them."""


def write(results: FolderResults, path: Path) -> None:
    """Write the metadata of the folder that `path` lies in."""
    now = rfc3339(datetime.now(UTC))
    files = [_file(results.folder, file) for file in files_of(results.folder)]
    first = min((facts.opened_at for facts in results.facts if facts.opened_at), default=now)
    graph: list[dict[str, Any]] = [
        {
            "@id": CRATE,
            "@type": "CreativeWork",
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
            "about": {"@id": "./"},
        },
        {
            "@id": "./",
            "@type": "Dataset",
            "name": results.folder.resolve().name,
            "description": (
                "Vibration envelopes measured from motion blur in photographs: "
                f"{len(results.envelopes)} envelopes of {len(results.targets)} targets"
            ),
            "dateCreated": first,
            "datePublished": now,
            "license": "not stated",
            "hasPart": [{"@id": one["@id"]} for one in files],
        },
        {
            "@id": f"#{PROJECT}",
            "@type": "SoftwareApplication",
            "name": PROJECT,
            "softwareVersion": __version__,
        },
        {
            "@id": "#measurement",
            "@type": "CreateAction",
            "name": "Motion of every target measured from the photographs",
            "endTime": now,
            "instrument": {"@id": f"#{PROJECT}"},
            "object": [{"@id": one["@id"]} for one in files if not one["@id"].startswith("results/")],
            "result": [{"@id": one["@id"]} for one in files if one["@id"].startswith("results/")],
        },
        *files,
    ]
    document = {"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph}
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def files_of(folder: Path) -> Iterator[Path]:
    """Files that a crate lists, sorted: no hidden and no partial ones, and not the crate itself."""
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        is_hidden = any(part.startswith(".") for part in inside.parts)
        if path.is_file() and not is_hidden and path.suffix not in {".part", ".tmp"} and inside.as_posix() != CRATE:
            yield path


def _file(folder: Path, path: Path) -> dict[str, Any]:
    entity: dict[str, Any] = {
        "@id": path.relative_to(folder).as_posix(),
        "@type": "File",
        "name": path.name,
        "contentSize": str(path.stat().st_size),
        "sha256": sha256_of(path),
    }
    if path.suffix.lower() in MEDIA_TYPES:
        entity["encodingFormat"] = MEDIA_TYPES[path.suffix.lower()]
    if path.name in DESCRIBED:
        entity["description"] = DESCRIBED[path.name]
    elif path.relative_to(folder).parts[0] in {"sharp", "captures"}:
        entity["description"] = f"photograph of camera {path.stem}"
    return entity
