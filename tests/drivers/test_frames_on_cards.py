"""Files from a simulated body's card to the disk, through the real driver: what is fetched, kept, and left alone."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from labdaemon.capture.collect import store, wait_frame
from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.own_frames import FrameContext, prepare_cameras, wait_frames
from labdaemon.capture.pairing import CameraClocks, Opening
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.clock import SystemClock
from labdaemon.errors import TransportError
from labdaemon.journal import card_records
from labdaemon.journal.journal import Journal


@pytest.fixture
def body(rig):
    return rig.bus.cameras["left"].body


@pytest.fixture
async def context(camera, tmp_path: Path) -> AsyncIterator[FrameContext]:
    clock, data = SystemClock(), tmp_path / "data"
    journal = Journal(data, clock, synchronous="OFF")
    recorder = Recorder(journal, ThreadExecutor("journal"))
    wired = DeviceHandle(camera, ThreadExecutor("left"))
    yield FrameContext(Rig(None, None, {"left": wired}), recorder, clock, data, CameraClocks(), lambda: 20.0)
    wired.executor.close()
    recorder.close()
    journal.close()


def shoot(rig, body, *, wait: bool = True) -> Opening:
    """One shot; returns once its file is on the card, however busy the machine is."""
    before, opened_s = len(on_card(body)), time.monotonic()
    assert body.release(rig.clock()) is not None
    while wait and len(on_card(body)) == before and time.monotonic() < opened_s + 20.0:
        time.sleep(0.02)
    time.sleep(0.15)  # until it can be released again
    return Opening("c", "one", opened_s, 0.01)


def on_card(body) -> list[str]:
    items = (body.card.get(handle) for handle in body.card.handles())
    return sorted(item.name for item in items if item is not None and item.path is not None)


async def keep(context: FrameContext, file, name="left.dng") -> bytes:
    camera, path = context.rig.cameras["left"], context.data / "captures" / "one" / name
    frame = await store(camera, file, path, context.recorder, context.clock, campaign="c", capture="one")
    content = (context.data / frame.path).read_bytes()
    assert len(content) == frame.size_bytes
    return content


@pytest.mark.parametrize(
    ("fault", "value"),
    [("zero_size", 1), ("zero_size", 5), ("half_size", 1.5), ("huge_size", 1), ("huge_size", 4), ("empty_info", 3)],
)
async def test_a_frame_is_whole_whatever_size_the_body_says_at_first(rig, body, context, fault, value):
    """Half the size, said for longer than it takes to believe it, is seen through by the file's own structure."""
    body.faults.inject(fault, value=value)
    opening = shoot(rig, body, wait=False)
    file = (await wait_frames(context, opening, {}))["left"]
    handle = next(handle for handle in body.card.handles() if body.card.get(handle).path is not None)
    whole = body.card.read(body.card.get(handle), 0, 1 << 24)
    assert await keep(context, file) == whole
    assert on_card(body) == []
    assert card_records.card_files(context.recorder.journal, "left") == {}


async def test_a_file_that_is_never_written_is_no_frame_and_stays(rig, body, context):
    body.faults.inject("half_size", value=600.0)
    context.timeout_s = lambda: 2.0
    with pytest.raises(TransportError, match=r"DSC_0001\.DNG is not written to its end"):
        await wait_frames(context, shoot(rig, body), {})
    assert on_card(body) == ["DSC_0001.DNG"]
    assert not list(context.data.rglob("*.dng*"))


async def test_two_unexplained_files_of_one_name_are_both_kept(rig, body, context):
    for fault in ("one_name", "no_date", "reuse_handles"):
        body.faults.inject(fault)
    for _ in range(3):
        shoot(rig, body)
        await prepare_cameras(context)
    kept = sorted(path.name for path in (context.data / "set_aside").rglob("*.DNG"))
    assert kept == ["left-DSC_0001.DNG", "left-DSC_0001~2.DNG", "left-DSC_0001~3.DNG"]
    assert on_card(body) == []


@pytest.mark.parametrize("partial", [True, False])
async def test_companions_of_a_frame_stay_on_the_card(rig, body, context, camera, partial):
    body.faults.inject("companions")
    if not partial:
        body.faults.inject("no_partial")
        camera.connect()
    for turn in range(2):
        file = (await wait_frames(context, shoot(rig, body), {}))["left"]
        assert file.name == f"DSC_000{turn + 1}.DNG"
        await keep(context, file, f"{turn}.dng")
        await prepare_cameras(context)
    assert len(on_card(body)) == 10
    assert {name[-4:] for name in on_card(body)} == {".JPG", ".HIF", ".NDF", ".XMP", ".MOV"}
    assert not (context.data / "set_aside").exists()


async def test_broken_foreign_objects_are_passed_over(rig, body, context):
    body.faults.inject("broken_object", count=1)
    await keep(context, (await wait_frames(context, shoot(rig, body), {}))["left"])
    await prepare_cameras(context)
    await keep(context, (await wait_frames(context, shoot(rig, body), {}))["left"], "next.dng")
    assert len(on_card(body)) == 2


async def test_a_file_of_before_the_release_is_not_its_own(rig, body, context):
    """Still being written when the shutters are released: no clock is needed to know that."""
    body.faults.inject("no_date")
    body.faults.inject("half_size", value=600.0)
    shoot(rig, body)
    seen = await prepare_cameras(context)
    assert len(seen["left"]) == 1
    body.faults.clear("half_size")
    own = (await wait_frames(context, shoot(rig, body), seen))["left"]
    assert own.name == "DSC_0002.DNG"
    await keep(context, own)
    await prepare_cameras(context)
    assert [path.name for path in (context.data / "set_aside").rglob("*.DNG")] == ["left-DSC_0001.DNG"]


async def test_a_file_that_grew_after_it_was_fetched_is_not_deleted(rig, body, context):
    shoot(rig, body)
    camera = context.rig.cameras["left"]
    file = await wait_frame(camera, context.recorder, context.clock, 5.0)
    assert file is not None
    driver, download = camera.driver, camera.driver.download
    item = body.card.get(file.handle)

    def grow(file, to):
        download(file, to)
        content = item.path.read_bytes() + b"written last"
        body.card.delete(item.handle)
        body.card.add(content, item.captured_at, name=item.name, reuse_handle=True)

    driver.download = grow
    await keep(context, file)
    del driver.download
    assert on_card(body) == ["DSC_0001.DNG"]
    await prepare_cameras(context)
    [in_background] = (context.data / "set_aside").rglob("*.DNG")
    assert in_background.read_bytes().endswith(b"written last")
    assert on_card(body) == []
