"""A night in small: many shots, faults at random; in the end every file was fetched once, whole, and left the card."""

from __future__ import annotations

import random
import time
from collections import Counter

import pytest

from labdaemon.errors import DeviceError

pytestmark = pytest.mark.slow

PASSING = [
    "silent", "rubbish", "wrong_transaction", "stall", "stall_out", "pipe_error", "cut_data", "late_zlp",
    "stale_answer", "lost_event", "no_get_event", "no_interrupt", "event_flood", "already_open", "session_stuck",
    "busy", "short_partial", "file_vanishes", "bad_dataset",
]  # fmt: skip


class Collector:
    """What a daemon does with one camera: connect again after a fault, fetch, verify, then delete."""

    def __init__(self, camera, folder):
        self.camera, self.folder = camera, folder
        self.fetched = Counter()
        self.faults = Counter()
        self._pending = None
        self._well = True

    def attempt(self):
        try:
            if not self._well:
                self.camera.close()
                self.camera.connect()
                self._well = True
            if self._pending is None:
                self._pending = self.camera.wait_file(0.3)
            if self._pending is not None:
                to = self.folder / self._pending.name
                self.camera.download(self._pending, to)
                self.camera.delete(self._pending)
                self.fetched[self._pending.name] += 1
                self._pending = None
        except DeviceError as exc:
            self.faults[type(exc).__name__] += 1
            self._well = False


@pytest.mark.parametrize("seed", [1])
def test_no_file_is_lost_doubled_or_torn(rig, make_camera, tmp_path, seed):
    rng = random.Random(seed)
    usb = rig.bus.cameras["left"]
    body, shots = usb.body, 40
    contents = {}
    add = body.card.add

    def remember(content, captured_at=None, **more):
        unique = content + rng.randbytes(rng.choice([0, 1, 400, 5000, 1_200_000]))
        # Noted first: once on the card, it may be fetched and deleted before anything else is done here.
        contents[f"DSC_{len(contents) + 1:04d}.DNG"] = unique
        return add(unique, captured_at, **more)

    body.card.add = remember
    collector = Collector(make_camera(timeout_s=0.25), tmp_path)
    for _ in range(shots):
        for _ in range(rng.randrange(3)):
            fault = rng.choice(PASSING)
            switches = body.faults if fault in body.faults.table else usb.faults
            switches.inject(fault, count=rng.randrange(1, 4), value=300 if fault == "event_flood" else None)
        if rng.random() < 0.1:
            rig.bus.unplug("left")
            rig.bus.plug("left")
        while body.release(rig.clock()) is None:
            time.sleep(0.02)
        end = time.monotonic() + 0.15
        while time.monotonic() < end:
            collector.attempt()
    body.faults.clear()
    usb.faults.clear()
    end = time.monotonic() + 60
    while len(collector.fetched) < shots and time.monotonic() < end:
        collector.attempt()
    assert set(collector.fetched) == set(contents)
    assert set(collector.fetched.values()) == {1}
    assert len(contents) == shots
    assert all((tmp_path / name).read_bytes() == content for name, content in contents.items())
    assert collector.camera.files() == []
    assert sum(collector.faults.values()) > 10
