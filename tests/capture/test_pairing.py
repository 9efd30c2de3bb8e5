from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture.devices import CardFile
from labdaemon.capture.pairing import Arrivals, CameraClocks, camera_seconds, is_frame
from labdaemon.errors import DeviceError


def stamped(seconds: float, name: str = "DSC_0001.NEF") -> CardFile:
    minute, second = divmod(int(seconds), 60)
    return CardFile(1, name, 10, f"20190101T10{minute:02d}{second:02d}")


@pytest.mark.parametrize(
    "text", ["20260504T101112", "2026-05-04T10:11:12", "20260504T101112.0", "20260504T101112+0200", " 20260504T101112Z"]
)
def test_times_are_read_as_bodies_write_them(text: str):
    assert camera_seconds(text) == pytest.approx(1777889472.0)


@pytest.mark.parametrize("text", ["", "yesterday", "20261340T101112", "00000000T000000"])
def test_what_is_no_time_is_none(text: str):
    assert camera_seconds(text) is None


def test_a_jpeg_beside_the_raw_file_is_no_frame():
    assert is_frame(stamped(0.0, "DSC_0001.NEF"))
    assert not is_frame(stamped(0.0, "DSC_0001.JPG"))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.5, 60.0), min_size=1, max_size=20), st.floats(-0.2, 0.2), st.sampled_from([0.25, 1.0]))
def test_openings_in_order_are_accepted_whatever_the_bodies_clocks_say(gaps, drift, exposure_s):
    clocks, opened_s = CameraClocks(), 100.0
    for gap in gaps:
        opened_s += gap
        files = {"left": stamped(opened_s), "right": stamped(opened_s + 900.0 + drift)}
        clocks.check(files, opened_s, exposure_s)


@pytest.mark.parametrize("off_s", [-8.0, -4.0, 5.0, 30.0])
def test_a_file_of_another_opening_is_refused(off_s: float):
    clocks = CameraClocks()
    clocks.check({"left": stamped(100.0), "right": stamped(100.0)}, 100.0, 1.0)
    with pytest.raises(DeviceError, match=r"right: DSC_0001.NEF was taken .* belongs to another one"):
        clocks.check({"left": stamped(160.0), "right": stamped(160.0 + off_s)}, 160.0, 1.0)
    clocks.check({"left": stamped(170.0), "right": stamped(170.0)}, 170.0, 1.0)


def test_a_body_that_was_away_may_come_back_with_another_time():
    clocks = CameraClocks()
    clocks.check({"left": stamped(100.0)}, 100.0, 1.0)
    clocks.forget("left")
    clocks.check({"left": stamped(900.0)}, 110.0, 1.0)


def test_files_of_outside_releases_are_sorted_into_captures():
    arrivals = Arrivals(("left", "right"), 5.0)
    first, second = stamped(1.0, "A.NEF"), stamped(9.0, "B.NEF")
    assert arrivals.add("left", first, 1.0) is None
    assert arrivals.add("left", second, 2.0) is None
    assert arrivals.add("right", first, 2.5) == {"left": first, "right": first}
    assert arrivals.late(6.9) == []
    assert arrivals.late(7.1) == [("left", second)]
    assert arrivals.add("right", second, 8.0) is None
