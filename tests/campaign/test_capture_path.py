"""A capture can be followed from the engine to the published event: few files, and two calls against the imports."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

FILES_MAX, CLIMBS_MAX = 25, 2


@pytest.fixture(scope="module")
def path() -> Any:
    """What `capture_path.py` measures, a script of no package, loaded from its file."""
    spec = importlib.util.spec_from_file_location("capture_path", Path(__file__).parents[1] / "capture_path.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look their own module up
    spec.loader.exec_module(module)
    return module.measure()


def test_the_way_is_short(path: Any) -> None:
    assert len(path.files) <= FILES_MAX, str(path)
    assert len(path.climbs) <= CLIMBS_MAX, str(path)


def test_the_way_is_seen_from_end_to_end(path: Any) -> None:
    """Were a landmark missed, the figures would be too good."""
    order = [
        "start_step", "FakeShaker.set", "intend_capture", "FakeTrigger.fire", "fire_capture", "expose_capture",
        "FakeCamera.download", "store_frame", "complete_capture", "FakeMeasurer.measure", "record_result",
    ]  # fmt: skip
    assert [name for name in path.landmarks if name in order] == order
    assert {"Transaction.emit", "EventPublisher.wake"} <= set(path.landmarks)
    assert {"labdaemon.campaign.engine", "labdaemon.journal.journal", "labdaemon.stream.publisher"} <= set(path.files)


def test_what_climbs_is_an_observer(path: Any) -> None:
    assert path.climbs == (
        ("labdaemon.capture.acquisition", "labdaemon.campaign.retry"),  # CaptureObserver: the campaign's
        ("labdaemon.capture.recorder", "labdaemon.stream.publisher"),  # CommitObserver
    )
