"""RAW frames as items of tiled: each file one item, which any tiled client downloads as it is.

bluesky's ``TiledWriter`` writes events into tiled, and files only where they are arrays that tiled can read and their
names count up. RAW files are neither: so each is registered as bytes, under ``frames`` of its run.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from labdaemon.errors import UsageError

FRAMES = "frames"
MIMETYPE = "application/octet-stream"
STREAM = "captures"


class FrameRegistrar:
    """A callback of documents. Subscribe it after the ``TiledWriter``, which makes the item of the run.

    Frames lie at ``client[RUN]["frames"][CAPTURE][CAMERA]``; ``raw_export`` downloads them. Their metadata are the
    capture's settings, camera and ``sha256``. The files stay where they are: tiled's ``readable_storage`` has to have
    the daemon's data folder in it.

    Parameters
    ----------
    client
        tiled's client of the container that the ``TiledWriter`` writes into.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._runs: dict[str, str] = {}
        """A descriptor's uid -> its run's."""
        self._cameras: dict[str, list[str]] = {}
        """A descriptor's uid -> the keys of its cameras."""

    def __call__(self, name: str, content: dict[str, Any]) -> None:
        """Take a document.

        Raises
        ------
        UsageError
            tiled does not have the run, or is too old to have items of bytes.
        """
        if name == "descriptor" and content.get("name") == STREAM:
            keys = content["data_keys"]
            self._runs[content["uid"]] = content["run_start"]
            self._cameras[content["uid"]] = [key for key, about in keys.items() if "external" in about]
        elif name == "event" and content["descriptor"] in self._runs:
            self._register(self._runs[content["descriptor"]], self._cameras[content["descriptor"]], content["data"])
        elif name == "stop":
            for descriptor in [uid for uid, run in self._runs.items() if run == content["run_start"]]:
                del self._runs[descriptor], self._cameras[descriptor]

    def _register(self, run: str, cameras: list[str], data: dict[str, Any]) -> None:
        try:
            node = self._client[run]
        except KeyError:
            raise UsageError(f"tiled has no run {run}; subscribe bluesky's TiledWriter before FrameRegistrar") from None
        frames = _container(_container(node, FRAMES, {}), data["capture"], {})
        for camera in cameras:
            if camera in frames:  # documents that were made again are the same
                continue
            path = Path(data[f"{camera}_path"])
            about = {"camera": camera, "file": path.name, "sha256": data[f"{camera}_sha256"]}
            about |= {key: value for key, value in data.items() if not key.startswith(f"{camera}_")}
            _new_bytes(frames, camera, path, about)


def _container(parent: Any, key: str, metadata: dict[str, Any]) -> Any:
    return parent[key] if key in parent else parent.create_container(key, metadata=metadata)


def _new_bytes(parent: Any, key: str, path: Path, metadata: dict[str, Any]) -> None:
    try:
        from tiled.structures.bytes import BytesStructure
        from tiled.structures.core import StructureFamily
        from tiled.structures.data_source import Asset, DataSource, Management
    except ImportError:
        raise UsageError(
            "this tiled has no items of bytes; version 0.2.20 has: pip install -U 'tiled[client]'"
        ) from None

    source = DataSource(
        structure_family=StructureFamily.bytes,
        structure=BytesStructure(),
        mimetype=MIMETYPE,
        assets=[Asset(data_uri=path.absolute().as_uri().replace("file://", "file://localhost", 1), is_directory=False,
                      parameter=None)],
        management=Management.external,
    )  # fmt: skip
    parent.new(StructureFamily.bytes, [source], key=key, metadata=metadata)
