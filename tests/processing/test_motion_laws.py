"""Which targets have which gauge's harmonics, and what unknown ones add."""

import math

import numpy as np
import pytest

from labdaemon.blur import Measurement
from labdaemon.events import GaugeMotion
from labdaemon.processing.motion_laws import AMPLITUDE_EFFECT, MotionLaws, harmonics_of, motion_laws


def motion(gauge="table", *, third=0.05, delta=0.7, sd=1e-4, size=2.0, **more) -> GaugeMotion:
    values = {
        "gauge": gauge, "amplitude_mm": size, "sd_amplitude_mm": sd,
        "h2_mm": 0.0001, "sd_h2_mm": sd * size,
        "h3_mm": third * size, "sd_h3_mm": sd * size, "h3_phase_rad": delta, "sd_h3_phase_rad": sd / max(third, 1e-9),
    }  # fmt: skip
    return GaugeMotion.model_validate({**values, **more})


def measured(target: str) -> Measurement:
    covariance = np.diag([1e-6] * 2 + [1e-4] * 4)
    return Measurement(target, np.zeros(2), np.array([3.0, 4.0]), np.zeros(2), covariance)


def test_a_gauges_harmonics_are_over_its_fundamental() -> None:
    one = harmonics_of(motion())
    assert one is not None
    assert one.cosine[0] == one.sine[0] == 0.0  # within its noise: no phase
    assert (one.cosine[1], one.sine[1]) == pytest.approx((0.05 * math.cos(0.7), 0.05 * math.sin(0.7)))
    assert one.sd == pytest.approx((math.hypot(5e-5, 1e-4), 1e-4))


@pytest.mark.parametrize(
    "more", [{"amplitude_mm": None}, {"amplitude_mm": 0.0}, {"h3_mm": None}, {"h3_mm": 1.9}, {"sd_h2_mm": 5.0}]
)
def test_a_gauge_that_shows_no_waveform_gives_none(more: dict[str, float | None]) -> None:
    assert harmonics_of(motion(**more)) is None
    assert motion_laws({"table": ("*",)}, [{"table": motion(**more)}]).of("L01") is None


def test_the_first_gauge_that_stands_for_a_target_counts() -> None:
    rules = {"table": ("B*", "X"), "response": ("*",)}
    laws = motion_laws(rules, [{"table": motion(), "response": motion("response", third=0.01)}])
    sizes = {name: laws.of(name) for name in ("B1", "X", "L01")}
    assert [one.size if one else None for one in sizes.values()] == pytest.approx([0.05, 0.05, 0.01])


def test_a_group_has_the_mean_and_its_scatter() -> None:
    captures = [{"table": motion(delta=0.6)}, {"table": motion(delta=0.8)}]
    one = motion_laws({"table": ("*",)}, captures).of("L01")
    assert one is not None
    assert math.atan2(one.sine[1], one.cosine[1]) == pytest.approx(0.7)
    assert one.sd[1] == pytest.approx(0.05 * math.sin(0.1), rel=0.4)


def test_a_gauge_that_missed_a_capture_of_the_group_stands_for_none() -> None:
    assert motion_laws({"table": ("*",)}, [{"table": motion()}, {}]).of("L01") is None


def test_unknown_harmonics_widen_the_amplitude_alone() -> None:
    laws = motion_laws({"table": ("B*",)}, [{"table": motion(third=0.05)}])
    before, after = measured("L01"), laws.with_unknown(measured("L01"))
    assert after.sd_px == pytest.approx(math.hypot(before.sd_px, AMPLITUDE_EFFECT * 0.05 * 5.0))
    across = np.array([-0.8, 0.6])
    assert across @ after.covariance_px2[2:4, 2:4] @ across == pytest.approx(1e-4)
    known = measured("B1")
    assert laws.with_unknown(known) is known


def test_noise_is_no_harmonic() -> None:
    laws = motion_laws({}, [{"table": motion(third=2e-4)}])
    assert laws.unknown == 0.0
    one = measured("L01")
    assert laws.with_unknown(one) is one
    assert MotionLaws().of("L01") is None
