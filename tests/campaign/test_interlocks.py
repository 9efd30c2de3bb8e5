from __future__ import annotations

import pytest

from labdaemon.campaign import interlocks
from labdaemon.campaign.interlocks import GaugeSample, InterlockLimits
from labdaemon.capture.devices import CameraStatus


def row(target: str, mm: float | None, *flags: str) -> dict[str, object]:
    return {"target": target, "ax_mm": mm, "ay_mm": 0.0, "az_mm": 0.0, "flags": list(flags)}


@pytest.mark.parametrize(("mm", "trips"), [(4.9, False), (5.1, True)])
def test_response_in_size(mm: float, trips: bool):
    assert (
        interlocks.check_response(InterlockLimits(max_response_mm=5.0), GaugeSample(0.0, mm), None) is not None
    ) == trips


@pytest.mark.parametrize(
    ("after_s", "mm", "sd", "trips"), [(1.0, 3.0, 0.0, True), (4.0, 3.0, 0.0, False), (1.0, 3.0, 1.0, False)]
)
def test_response_in_growth_and_what_is_noise(after_s: float, mm: float, sd: float, trips: bool):
    limits = InterlockLimits(max_response_rate_mm_s=1.5)
    found = interlocks.check_response(limits, GaugeSample(after_s, mm, sd), GaugeSample(0.0, 1.0, sd))
    assert (found is not None) == trips


@pytest.mark.parametrize(
    ("asked", "read", "sd", "trips"), [(1.0, 1.1, 0, False), (1.0, 1.3, 0, True), (0.01, 0.2, 0.1, False)]
)
def test_gauge_disagreement(asked: float, read: float, sd: float, trips: bool):
    assert (interlocks.check_table(InterlockLimits(), asked, GaugeSample(0.0, read, sd)) is not None) == trips
    assert interlocks.check_table(InterlockLimits(gauge_disagreement=None), asked, GaugeSample(0.0, read, sd)) is None


def test_battery_and_card_and_what_a_body_does_not_report():
    assert interlocks.check_camera(InterlockLimits(), "left", CameraStatus(None, None)) is None
    assert "battery at 9 %" in str(interlocks.check_camera(InterlockLimits(), "left", CameraStatus(9, None)))
    assert "100 MB free" in str(interlocks.check_camera(InterlockLimits(), "left", CameraStatus(90, 100_000_000)))


def test_workers():
    limits = InterlockLimits(worker_stall_s=300.0)
    assert interlocks.check_workers(limits, 299.0) is None
    assert "301 s" in str(interlocks.check_workers(limits, 301.0))


def test_envelopes_in_size_and_at_the_papers_edge():
    rows = [row("T1", 1.0), row("T2", None, "not_found"), row("T3", 3.0)]
    assert interlocks.check_envelope(InterlockLimits(max_response_mm=4.0), rows) is None
    assert "T3 moves 3 mm" in str(interlocks.check_envelope(InterlockLimits(max_response_mm=2.0), rows))
    edge = [*rows, row("T4", 1.0, "paper_edge")]
    assert "1 of 4 targets" in str(interlocks.check_envelope(InterlockLimits(), edge))
    assert interlocks.check_envelope(InterlockLimits(max_paper_edge=0.25), edge) is None


def test_a_motion_in_b_counts_whole():
    turning = row("T1", 0.1) | {"bx_mm": 0.0, "by_mm": 3.0, "bz_mm": 0.0}
    assert "T1 moves 3 mm" in str(interlocks.check_envelope(InterlockLimits(max_response_mm=2.0), [turning]))


def test_no_doubtful_target_trips_alone_and_several_do():
    limits = InterlockLimits(max_response_mm=0.6, max_paper_edge=None)
    rows = [row(f"T{n:02d}", 0.4) for n in range(20)]
    assert interlocks.check_envelope(limits, [*rows, row("R12", 0.977, "ambiguous")]) is None
    assert interlocks.check_envelope(limits, [*rows, *[row(f"R{n}", 0.9, "ambiguous") for n in range(5)]]) is None
    assert interlocks.check_envelope(limits, [*rows, row("R1", 0.9, "poor_fit")]) is None
    edges = [row(f"R{n}", 70.0 + n, "paper_edge") for n in range(3)]
    assert "3 flagged targets" in str(interlocks.check_envelope(limits, [*rows, *edges]))
    alone = [row(f"R{n}", 0.9, "ambiguous") for n in range(3)]
    assert "3 flagged targets" in str(interlocks.check_envelope(limits, alone))
