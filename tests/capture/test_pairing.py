from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.capture.devices import CardFile
from labdaemon.capture.pairing import CameraClocks, FileOrigin, Opening, ReleasePairing, camera_seconds, is_frame


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


@pytest.mark.parametrize(
    ("name", "form", "may_be"),
    [
        ("DSC_0001.NEF", 0x3000, True),
        ("DSC_0001.NEF", 0, True),
        ("IMG_0001.CR3", 0xB108, True),
        ("DSC00001.ARW", 0xB101, True),
        ("x.DNG", 0x3811, True),
        ("DSC_0001.JPG", 0x3801, False),
        ("DSC_0001.JPG", 0, False),
        ("DSC_0001.HIF", 0x3000, False),
        ("DSC_0001.HEIC", 0xB110, False),
        ("DSC_0001.NDF", 0x3000, False),
        ("DSC_0001.xmp", 0x3000, False),
        ("DSC_0001.MOV", 0x300D, False),
        ("DSC_0001", 0x3801, False),
        ("100NCD80", 0x3001, False),
    ],
)
def test_a_frame_by_format_and_name(name: str, form: int, may_be: bool):
    assert is_frame(CardFile(1, name, 10, "", form)) is may_be


def opening(opened_s: float, exposure_s: float = 1.0, capture: str = "c") -> Opening:
    return Opening("0001-x", capture, opened_s, exposure_s)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0.5, 60.0), min_size=1, max_size=20),
    st.floats(-0.2, 0.2),
    st.sampled_from([0.25, 1.0, 10.0]),
    st.booleans(),
)
def test_openings_in_order_are_accepted_whatever_the_bodies_clocks_say(gaps, drift, exposure_s, stamps_end):
    clocks, opened_s = CameraClocks(), 100.0
    for gap in gaps:
        opened_s += gap
        end_s = exposure_s if stamps_end else 0.0
        files = {"left": stamped(opened_s), "right": stamped(opened_s + 900.0 + drift + end_s)}
        for camera, file in files.items():
            assert clocks.judge(camera, file, opening(opened_s, exposure_s)) is FileOrigin.OWN
        clocks.update(files, opening(opened_s, exposure_s))


@pytest.mark.parametrize("off_s", [-8.0, -4.0, 5.0, 30.0])
@pytest.mark.parametrize("exposure_s", [1.0, 10.0])
def test_a_file_of_another_opening_is_refused(off_s: float, exposure_s: float):
    clocks = CameraClocks()
    clocks.update({"right": stamped(100.0)}, opening(100.0, exposure_s))
    assert clocks.judge("right", stamped(160.0 + off_s), opening(160.0, exposure_s)) is FileOrigin.FOREIGN
    assert clocks.judge("right", stamped(170.0), opening(170.0, exposure_s)) is FileOrigin.OWN


def test_a_late_file_is_its_own_opening_s_also_after_a_restart():
    clocks = CameraClocks()
    clocks.load("left", camera_seconds("20190101T100000") or 0.0, 10.0, 50.0)
    earlier, now = opening(100.0, 10.0, "a"), opening(115.0, 10.0, "b")
    assert clocks.judge("left", stamped(100.0), now, [earlier]) is FileOrigin.EARLIER
    assert clocks.owner("left", stamped(100.0), [earlier]) == earlier
    assert clocks.judge("left", stamped(115.0), now, [earlier]) is FileOrigin.OWN


def test_two_openings_too_near_for_the_clock_are_not_guessed():
    clocks = CameraClocks()
    clocks.update({"left": stamped(90.0)}, opening(90.0))
    assert clocks.judge("left", stamped(101.0), opening(102.0), [opening(100.0)]) is FileOrigin.UNCLEAR
    assert not clocks.can_distinguish("left", opening(100.0), 102.0)
    assert clocks.can_distinguish("left", opening(100.0), 106.0)


@pytest.mark.parametrize("captured_at", ["", "20000101T000000"])
def test_a_body_without_a_useful_clock_is_paired_by_order(captured_at: str):
    """No date, or a clock that stands still: it is found out after two openings that it did not fit."""
    clocks, file = CameraClocks(), CardFile(1, "DSC_0001.NEF", 10, captured_at)
    refused = 0
    for turn in range(6):
        now = opening(100.0 + 20.0 * turn)
        if clocks.judge("left", file, now) is FileOrigin.OWN:
            clocks.update({"left": file}, now)
        else:
            refused += 1
            clocks.invalidate("left")  # the fault makes the daemon connect anew
    assert refused == (1 if captured_at else 0)
    assert clocks.judge("left", file, opening(300.0), [opening(290.0)]) is FileOrigin.UNCLEAR
    assert not clocks.can_distinguish("left", opening(100.0), 300.0)


def test_a_clock_that_a_person_sets_costs_one_capture():
    clocks = CameraClocks()
    clocks.update({"left": stamped(100.0)}, opening(100.0))
    assert clocks.judge("left", stamped(920.0), opening(120.0)) is FileOrigin.FOREIGN
    assert clocks.judge("left", stamped(940.0), opening(140.0)) is FileOrigin.OWN
    clocks.update({"left": stamped(940.0)}, opening(140.0))
    assert clocks.judge("left", stamped(150.0), opening(160.0)) is FileOrigin.FOREIGN
    assert clocks.judge("left", stamped(960.0), opening(160.0)) is FileOrigin.OWN


def test_a_body_that_was_away_may_come_back_with_another_time():
    clocks = CameraClocks()
    clocks.update({"left": stamped(100.0)}, opening(100.0))
    clocks.invalidate("left")
    assert clocks.judge("left", stamped(900.0), opening(120.0), [opening(110.0)]) is FileOrigin.UNCLEAR
    assert clocks.judge("left", stamped(900.0), opening(120.0)) is FileOrigin.OWN


def test_files_of_outside_releases_are_sorted_into_captures():
    arrivals = ReleasePairing(("left", "right"), 5.0)
    first, second = stamped(1.0, "A.NEF"), stamped(9.0, "B.NEF")
    assert arrivals.add("left", first, 1.0) is None
    assert arrivals.add("left", second, 2.0) is None
    assert arrivals.add("right", first, 2.5) == {"left": first, "right": first}
    assert arrivals.late(6.9) == []
    assert arrivals.late(7.1) == [("left", second)]
    assert arrivals.add("right", second, 8.0) is None


def test_a_release_that_one_body_missed_does_not_pair_its_next_frame_with_the_others_last():
    arrivals = ReleasePairing(("left", "right"), window_s=5.0)
    skew_s = 300.0  # the bodies' clocks are minutes apart
    assert arrivals.add("left", stamped(10), 100.0) is None
    assert arrivals.add("right", stamped(10 + skew_s), 100.4) is not None
    assert arrivals.add("left", stamped(20), 110.0) is None  # right was not released
    assert arrivals.add("right", stamped(24 + skew_s), 113.5) is None
    pair = arrivals.add("left", stamped(23), 113.7)  # whole seconds: one more or less
    assert pair is not None
    assert pair["left"].captured_at == stamped(23).captured_at
    assert [(camera, file.captured_at) for camera, file in arrivals.late(114.0)] == [("left", stamped(20).captured_at)]
    assert arrivals.first_s == 113.5


def test_a_clock_that_was_set_costs_one_capture_and_no_clock_pairs_by_order():
    arrivals = ReleasePairing(("left", "right"), window_s=5.0)
    paired = []
    for number in range(6):
        lag_s = 0.0 if number < 2 else 50.0  # somebody sets the right one's clock
        at_s = 100.0 + 10.0 * number
        arrivals.add("left", stamped(10.0 * number), at_s)
        paired.append(arrivals.add("right", stamped(10.0 * number + lag_s), at_s + 0.2) is not None)
        arrivals.late(at_s + 9.0)
    assert paired == [True, True, False, True, True, True]
    blind = ReleasePairing(("left", "right"), window_s=5.0)
    assert blind.add("left", CardFile(1, "a.NEF", 10, ""), 1.0) is None
    assert blind.add("right", CardFile(1, "b.NEF", 10, ""), 2.0) is not None
