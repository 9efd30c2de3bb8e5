"""What users report of bodies' files, each by its name in the simulator."""

from __future__ import annotations

import time

import pytest

from labdaemon.errors import DeviceRefused, ProtocolError
from labdrivers.sim.ptp_device import COMPANIONS


@pytest.fixture
def body(rig):
    return rig.bus.cameras["left"].body


def shoot(rig, body):
    """One shot; returns once its file is on the card, however busy the machine is."""
    before, end_s = len(body.card.handles()), time.monotonic() + 20.0
    assert body.release(rig.clock()) is not None
    while len(body.card.handles()) == before and time.monotonic() < end_s:
        time.sleep(0.02)
    time.sleep(0.15)  # until it can be released again


def fetch(camera, file, to):
    camera.download(file, to)
    camera.delete(file)
    return to.read_bytes()


@pytest.mark.parametrize(("fault", "value"), [("zero_size", 1), ("zero_size", 6), ("half_size", 0.15)])
def test_a_file_is_reported_when_its_size_has_settled(rig, body, camera, tmp_path, fault, value):
    body.faults.inject(fault, value=value)
    for turn in range(2):
        shoot(rig, body)
        file = camera.wait_file(15.0)
        item = body.card.get(file.handle)
        whole = body.card.read(item, 0, item.size_bytes)
        assert file.size_bytes == len(whole)
        assert fetch(camera, file, tmp_path / str(turn)) == whole


def test_a_size_that_stood_still_too_early_is_found_out(rig, body, camera, tmp_path):
    """Half the size, said twice: what was fetched then is neither believed nor deleted."""
    body.faults.inject("half_size", value=30.0)
    shoot(rig, body)
    half = camera.wait_file(15.0)
    to = tmp_path / "f"
    camera.download(half, to)
    body.faults.clear("half_size")  # it is written now
    with pytest.raises(DeviceRefused, match="it is kept"):
        camera.delete(half)
    with pytest.raises(ProtocolError, match="bytes"):
        camera.download(half, to)
    whole = camera.describe(half)
    assert whole.size_bytes > 1.9 * half.size_bytes
    assert len(fetch(camera, whole, to)) == whole.size_bytes
    assert camera.files() == []


def test_a_file_that_is_written_at_the_first_connection_is_news(rig, body, make_camera):
    body.faults.inject("zero_size", value=1)
    shoot(rig, body)
    camera = make_camera()
    assert camera.wait_file(15.0).name == "DSC_0001.DNG"


@pytest.mark.parametrize("told", ["lost_event", None])
def test_files_that_differ_in_nothing_are_each_reported(rig, body, camera, tmp_path, told):
    """One name, no date, one size, and the handle of the file before: only its deletion tells them apart."""
    for fault in ("one_name", "no_date", "reuse_handles", *([told] if told else [])):
        body.faults.inject(fault)
    seen = set()
    for turn in range(2):
        shoot(rig, body)
        file = camera.wait_file(15.0)
        seen.add(file)
        fetch(camera, file, tmp_path / str(turn))
    assert len(seen) == 1
    assert camera.wait_file(0.2) is None


def test_a_file_that_a_person_deletes_makes_room_for_another_like_it(rig, body, camera):
    for fault in ("one_name", "no_date", "reuse_handles"):
        body.faults.inject(fault)
    shoot(rig, body)
    file = camera.wait_file(15.0)
    body.card.delete(file.handle)
    assert camera.files() == []
    shoot(rig, body)
    assert camera.wait_file(15.0) == file


def test_a_handle_that_was_given_away_anew_deletes_nothing(rig, body, camera):
    body.faults.inject("reuse_handles")
    shoot(rig, body)
    first = camera.wait_file(15.0)
    body.card.delete(first.handle)
    shoot(rig, body)
    second = camera.wait_file(15.0)
    assert second.handle == first.handle
    with pytest.raises(DeviceRefused, match=r"has DSC_0002\.DNG"):
        camera.delete(first)
    assert [file.name for file in camera.files()] == ["DSC_0002.DNG"]


def test_companions_come_with_their_format_and_content(rig, body, camera):
    body.faults.inject("companions")
    shoot(rig, body)
    files = {file.name: file for file in (camera.wait_file(15.0) for _ in range(6))}
    for ending, form, data in COMPANIONS:
        file = files[f"DSC_0001{ending}"]
        assert file.format == form
        assert camera.read(file, 0, 64) == data[:64]
        assert camera.read(file, len(data) - 3, 64) == data[-3:]
    assert camera.read(files["DSC_0001.DNG"], 0, 4) == b"II*\0"


def test_one_broken_object_hides_no_other(rig, body, make_camera):
    body.faults.inject("broken_object", count=1)
    shoot(rig, body)
    camera = make_camera()
    assert [name for name in (file.name for file in camera.files()) if name.startswith("DSC")] == ["DSC_0001.DNG"]
    assert all(file.name.encode() for file in camera.files())  # no lone surrogate is left in a name
    shoot(rig, body)
    assert camera.wait_file(15.0).name == "DSC_0002.DNG"


def test_a_body_that_sends_files_only_whole(rig, body, camera):
    body.faults.inject("no_partial")
    camera.connect()
    shoot(rig, body)
    file = camera.wait_file(15.0)
    with pytest.raises(DeviceRefused, match="only whole"):
        camera.read(file, 0, 64)
