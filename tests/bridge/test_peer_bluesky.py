"""bluesky's own dispatcher receives the documents, and tiled's client writes them: needs the extra ``peers``."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("bluesky", reason="bluesky is not installed (extra peers)")
pytest.importorskip("tiled", reason="tiled is not installed (extra peers)")

from labdaemon.bridge.bluesky_bridge import DocumentPublisher
from labdaemon.bridge.bluesky_documents import DocumentMaker
from labdaemon.bridge.tiled_frames import FrameRegistrar
from labdaemon.errors import UsageError
from labdaemon.testing.served import TARGETS, event_document

pytestmark = [
    pytest.mark.peers,
    pytest.mark.slow,
    # Theirs, not ours: what these versions warn of in one another.
    pytest.mark.filterwarnings("ignore"),
]
CAMPAIGN = "0001-three-modes"


@pytest.fixture
def documents(tmp_path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Of a campaign of two captures whose frames are there."""
    maker, found = DocumentMaker(tmp_path), []
    said: list[tuple[str, dict[str, Any]]] = [("campaign.started", {"name": "three-modes"})]
    for name in ("c1", "c2"):
        path = tmp_path / "campaigns" / CAMPAIGN / "captures" / name / "left.dng"
        path.parent.mkdir(parents=True)
        path.write_bytes(b"raw " + name.encode())
        frames = [{"camera": "left", "path": str(path.relative_to(tmp_path)), "size_bytes": 6, "sha256": "00"}]
        said.append(("capture.completed", {"capture": name, "frames": frames, "exposure_s": 1.0}))
        said.append(("envelope", {"capture": name, "targets": TARGETS, "frequency_hz": 5.0}))
    said.append(("campaign.completed", {}))
    for seq, (kind, data) in enumerate(said, 1):
        found += maker.feed(event_document(seq, kind, **data) | {"campaign": CAMPAIGN})
    return found


@pytest.mark.parametrize("before", [0, 5], ids=["from the beginning", "in the middle of a run"])
def test_a_remote_dispatcher_receives_all(documents: list[tuple[str, dict[str, Any]]], before: int):
    from bluesky.callbacks.zmq import RemoteDispatcher

    with DocumentPublisher("tcp://127.0.0.1:*") as publisher:
        for document in documents[:before]:
            publisher.publish(document)
        dispatcher = RemoteDispatcher(publisher.address)
        received: list[tuple[str, dict[str, Any]]] = []
        ended = threading.Event()

        def keep(name: str, doc: dict[str, Any]) -> None:
            received.append((name, doc))
            if name == "stop":
                ended.set()

        dispatcher.subscribe(keep)
        thread = threading.Thread(target=dispatcher.start, daemon=True)
        thread.start()
        assert publisher.wait_for_subscriber(30.0)
        for document in documents[before:]:
            publisher.publish(document)
        assert ended.wait(30.0)
        dispatcher.loop.call_soon_threadsafe(dispatcher.stop)
        thread.join(10.0)
    assert [name for name, _ in received] == [name for name, _ in documents]
    assert [doc["uid"] for _, doc in received] == [doc["uid"] for _, doc in documents]


@pytest.fixture
def tiled(tmp_path: Path) -> Iterator[Any]:
    """A client of a tiled that may read the data folder."""
    from tiled.catalog import in_memory
    from tiled.client import Context, from_context
    from tiled.server.app import build_app

    (tmp_path / "tiled").mkdir()
    catalog = in_memory(
        writable_storage=[f"file://localhost{tmp_path}/tiled", f"duckdb:///{tmp_path}/tables.db"],
        readable_storage=[str(tmp_path)],
    )
    with Context.from_app(build_app(catalog)) as context:
        yield from_context(context)


def test_tiled_writes_a_run_and_serves_each_frame(documents: list[tuple[str, dict[str, Any]]], tiled: Any):
    from bluesky.callbacks.tiled_writer import TiledWriter

    callbacks = [TiledWriter(tiled), FrameRegistrar(tiled)]
    for name, doc in documents:
        for callback in callbacks:
            callback(name, doc)
    for name, doc in documents:  # made again, as after a restart
        callbacks[1](name, doc)
    run = tiled[documents[0][1]["uid"]]
    assert run.metadata["start"]["campaign"] == CAMPAIGN
    assert run.metadata["stop"]["exit_status"] == "success"
    envelopes = run["envelopes"].base["internal"].read()
    assert list(envelopes["capture"]) == ["c1", "c2"]
    # Tiled reads lists back as text.
    assert "P1" in str(envelopes["target"][0])
    assert "0.5" in str(envelopes["ax_mm"][0])
    frames = run["frames"]
    assert list(frames) == ["c1", "c2"]
    for capture in frames:
        item = frames[capture]["frame_left"]
        assert item.structure_family == "bytes"
        assert (item.metadata["sha256"], item.metadata["file"]) == ("00", "left.dng")
        files: dict[str, Any] = {}
        item.raw_export(files)
        assert [found.getvalue() for found in files.values()] == [b"raw " + capture.encode()]


def test_frames_of_a_run_that_tiled_does_not_have_are_refused(documents: list[tuple[str, dict[str, Any]]], tiled: Any):
    registrar = FrameRegistrar(tiled)
    before = next(place for place, (name, _) in enumerate(documents) if name == "event")
    for name, doc in documents[:before]:
        registrar(name, doc)
    with pytest.raises(UsageError, match="before FrameRegistrar"):
        registrar(*documents[before])
