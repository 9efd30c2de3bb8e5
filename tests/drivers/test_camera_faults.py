"""Every fault of a camera and of its USB side: noticed in bounded time or overcome, and no file lost or doubled."""

from __future__ import annotations

import time

import pytest

from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError
from labdrivers.sim.ptp_device import FAULTS as BODY
from labdrivers.sim.usb_device import FAULTS as USB

pytestmark = pytest.mark.slow


ANY = "."
OUTCOMES = {
    # the body
    "no_shutter": (None, "no file"),
    "card_full": (DeviceRefused, "card full"),
    "no_card": (None, "no file"),
    "low_battery": (None, "told by status"),
    "busy": (TransportError, "busy"),
    "lost_event": (None, ""),
    "no_interrupt": (None, ""),
    "no_get_event": (None, ""),
    "event_flood": (None, ""),
    "setting_ignored": (DeviceRefused, "reports"),
    "setting_locked": (DeviceRefused, "dial"),
    "session_stuck": (None, ""),
    "already_open": (None, ""),
    "no_partial": (None, ""),
    "short_partial": (None, ""),
    "file_vanishes": (None, "no file"),
    "wrong_serial": (TransportError, "no camera with serial"),
    "slow_file": (None, ""),
    "to_memory": (None, ""),
    "bad_dataset": ((ProtocolError, TransportError), ANY),
    # its USB side
    "silent": (TransportError, "no answer"),
    "late": (TransportError, "no answer"),
    "rubbish": (ProtocolError, "no container"),
    "wrong_transaction": (DeviceError, ANY),
    "stall": (None, ""),
    "stall_out": (TransportError, "pipe error"),
    "pipe_error": (TransportError, "pipe error"),
    "cut_data": (TransportError, "no answer"),
    "late_zlp": (None, ""),
    "no_zlp": (None, ""),
    "split_header": (None, ""),
    "unknown_length": (None, ""),
    "interrupt_first": (None, ""),
    "stale_answer": (None, ""),
}


HABITS = {
    "zero_size", "half_size", "huge_size", "empty_info", "one_name", "no_date", "clock_reset", "clock_shift",
    "reuse_handles", "companions", "broken_object", "deaf_while_busy",
}  # fmt: skip
"""What bodies do that is no fault of theirs: tried in `test_camera_habits` and `test_frames_on_cards`."""


def test_the_table_covers_every_fault():
    assert set(OUTCOMES) | HABITS == set(BODY) | set(USB)
    assert not set(OUTCOMES) & HABITS
    assert not set(BODY) & set(USB)


def a_captures_work(rig, camera, folder, eventually, *, wait_s=30.0):
    """Settings, a shot by cable, its file fetched and deleted; the file's name, None if none came."""
    body = rig.bus.cameras["left"].body
    exposure_s = 0.008 if body.settings.exposure_s > 0.009 else 0.01
    camera.configure(exposure_s=exposure_s)
    assert camera.status().battery_percent is not None
    # It may be busy with the shot before, and does not open at all with some faults.
    eventually(lambda: body.release(rig.clock()) is not None, min(wait_s, 10.0))
    file = camera.wait_file(wait_s)
    if file is None:
        return None
    to = folder / file.name
    camera.download(file, to)
    assert to.stat().st_size == file.size_bytes
    card = body.card
    assert to.read_bytes() == card.read(card.get(file.handle), 0, file.size_bytes)
    camera.delete(file)
    return file.name


@pytest.mark.parametrize("fault", OUTCOMES)
def test_a_capture_with_a_fault(rig, make_camera, tmp_path, monkeypatch, eventually, fault):
    monkeypatch.setattr("labdrivers.ptp.watch.LIST_EVERY_S", 0.4)
    error, words = OUTCOMES[fault]
    usb = rig.bus.cameras["left"]
    switches = usb.body.faults if fault in BODY else usb.faults
    camera = make_camera(timeout_s=0.6 if error is not None else 5.0)
    switches.inject(fault, value={"late": 1.0, "slow_file": 0.5}.get(fault))
    if fault in ("session_stuck", "wrong_serial", "no_partial"):
        camera.close()  # these show when a session begins
    start = time.monotonic()

    def work():
        if fault in ("session_stuck", "wrong_serial", "no_partial"):
            camera.connect()
        return a_captures_work(rig, camera, tmp_path, eventually, wait_s=1.2 if words == "no file" else 30.0)

    if error is None:
        name = work()
        assert (name is None) == (words == "no file")
        if fault == "low_battery":
            assert camera.status().battery_percent == 3
    else:
        with pytest.raises(error, match=words):
            work()
    assert time.monotonic() - start < 60.0
    usb.body.faults.clear()
    usb.faults.clear()
    camera.connect()
    while (left := camera.wait_file(0.3)) is not None:  # a file that came in spite of the fault
        camera.delete(left)
    assert a_captures_work(rig, camera, tmp_path, eventually) is not None


@pytest.mark.parametrize("fault", ["stall", "stale_answer", "late_zlp", "stall_out"])
def test_faults_that_strike_once_are_not_even_noticed(rig, camera, tmp_path, eventually, fault):
    usb = rig.bus.cameras["left"]
    for _ in range(6):
        usb.faults.inject(fault, count=1)
        assert camera.status().battery_percent == 90
    assert a_captures_work(rig, camera, tmp_path, eventually) is not None


def test_a_flood_of_property_changes_delays_no_file(rig, camera):
    body = rig.bus.cameras["left"].body
    body.faults.inject("event_flood", value=5000)
    body.release(rig.clock())
    assert camera.wait_file(30.0) is not None


def test_the_session_survives_a_fault_without_a_new_connection(rig, camera, tmp_path, eventually):
    """After a cancelled transaction the next one must get its own answer, not the old one's."""
    usb = rig.bus.cameras["left"]
    for fault in ("silent", "pipe_error", "cut_data", "rubbish"):
        usb.faults.inject(fault, count=1)
        with pytest.raises(DeviceError):
            camera.files()
        assert camera.status().battery_percent == 90
    assert a_captures_work(rig, camera, tmp_path, eventually) is not None


def test_unplugged_while_waiting(rig, camera):
    import threading

    threading.Timer(0.3, rig.bus.unplug, args=("left",)).start()
    start = time.monotonic()
    with pytest.raises(TransportError, match="gone from the bus"):
        camera.wait_file(120.0)
    assert time.monotonic() - start < 60.0


def test_another_body_in_its_place(rig, camera):
    rig.bus.unplug("left")
    camera.close()
    with pytest.raises(TransportError, match=r"6000001.*found one with serial number 6000002"):
        camera.connect()
