"""A frame's extra blur from its control targets, or from the moving targets themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.defocus_settings import DEFOCUS
from labdaemon.blur.motion import Defocus, Measurement, StaticMeasurement
from labdaemon.blur.patch.pixels import NoiseModel
from labdaemon.blur.sharp.target import EllipseShape, LensPsf, SharpTarget
from labdaemon.blur.smear.defocus import estimate_frame_defocus, estimate_target_defocus, with_anisotropy
from labdaemon.blur.smear.uncertainty import anisotropy_covariance
from labdaemon.errors import DataError
from labdaemon.flags import Flag


def still(defocus_px2: float, sd: float = 0.01) -> StaticMeasurement:
    return StaticMeasurement("C1", np.zeros(2), np.zeros(2), defocus_px2, np.diag([1e-4, 1e-4, sd**2]))


def moving(defocus_px2: float, *flags: Flag) -> Measurement:
    return Measurement(
        "T1", np.zeros(2), np.ones(2), np.zeros(2), np.eye(6), flags=frozenset(flags), defocus_px2=defocus_px2
    )


def test_a_frames_defocus_is_the_mean_of_its_controls() -> None:
    found = estimate_frame_defocus([still(0.1), still(0.12), still(0.11)])
    assert found.mean_px2 == pytest.approx(0.11, abs=0.001)
    assert found.sd_px2 >= DEFOCUS.common_error_sd_px2


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(-0.2, 0.5), st.floats(1.0, 50.0))
def test_one_control_that_is_wrong_hardly_moves_it(mean: float, wrong: float) -> None:
    good = [still(mean + part) for part in (-0.01, -0.005, 0.0, 0.005, 0.01)]
    assert estimate_frame_defocus([*good, still(mean + wrong)]).mean_px2 == pytest.approx(mean, abs=0.02)


def test_controls_that_scatter_say_how_little_is_known() -> None:
    close = estimate_frame_defocus([still(0.1 + 0.001 * k) for k in range(4)])
    apart = estimate_frame_defocus([still(0.1 + 0.1 * k) for k in range(4)])
    assert apart.sd_px2 > close.sd_px2


def test_without_a_usable_control_there_is_none() -> None:
    with pytest.raises(DataError, match="no control target could be measured"):
        estimate_frame_defocus([still(float("nan"))])
    with pytest.raises(DataError):
        estimate_frame_defocus([])


def test_targets_say_it_when_there_are_three() -> None:
    assert estimate_target_defocus([moving(0.1), moving(0.1)]) is None
    found = estimate_target_defocus([moving(0.1), moving(0.12), moving(0.11)])
    assert found is not None
    assert found.mean_px2 == pytest.approx(0.11, abs=0.005)
    assert found.sd_px2 >= DEFOCUS.min_scatter_px2
    assert found.anisotropy_px2 >= 2 * abs(found.mean_px2), "as far as it goes it may be one-sided"


def test_targets_that_were_lost_say_nothing() -> None:
    lost = [moving(9.0, flag) for flag in (Flag.NOT_FOUND, Flag.SATURATED, Flag.OCCLUDED)]
    good = [moving(0.1), moving(0.12), moving(0.11)]
    found, clean = estimate_target_defocus([*lost, *good]), estimate_target_defocus(good)
    assert found == clean


def dot(variance_px2: float, width_px: float = 0.0) -> SharpTarget:
    lens = LensPsf(np.zeros(1, np.int64), np.array([variance_px2]), np.array([width_px]), np.zeros((1, 2)))
    form = EllipseShape(np.array([10.0, 0.0, 10.0]), lens, np.zeros((4, 4)))
    return SharpTarget("T1", np.zeros(2), np.eye(2), form, {}, NoiseModel(1.0, 0.1), True, 40.0, 1.0, frozenset())


def test_a_dot_out_of_focus_is_changed_more_by_a_change_of_focus() -> None:
    sharp, soft = with_anisotropy(Defocus(0.15, 0.03, 0.31), [dot(0.6), dot(2.6)])
    assert sharp.mean_px2 == soft.mean_px2 == 0.15
    assert 0.03 < sharp.sd_anisotropy_px2 < 0.1
    assert soft.sd_anisotropy_px2 > 4 * sharp.sd_anisotropy_px2


def test_a_frame_as_sharp_as_the_sharp_one_adds_nearly_nothing() -> None:
    found = with_anisotropy(Defocus(0.002, 0.005, 0.011), [dot(0.6), dot(2.6)])
    assert max(one.sd_anisotropy_px2 for one in found) < 0.002


def test_diffraction_counts_as_the_gaussian_that_passes_as_much() -> None:
    clear, stopped = dot(0.8), dot(0.8, 1.2)
    assert clear.form.lens.equivalent_variance_px2(0.15) == pytest.approx(0.8)
    assert 1.2 < stopped.form.lens.equivalent_variance_px2(0.15) < 1.8


@pytest.mark.parametrize("a", [(2.0, 0.0), (1.2, -1.6)])
def test_anisotropy_widens_the_sd_along_the_motion_alone(a: tuple[float, float]) -> None:
    vector = np.array(a)
    added = anisotropy_covariance(vector, 0.1)
    across = np.array([-vector[1], vector[0]])
    assert np.sqrt(vector @ added @ vector) / 2.0 == pytest.approx(0.1 / (2 * 2.0), rel=0.02)
    assert across @ added @ across == pytest.approx(0.0, abs=1e-12)
