"""A third harmonic without a gauge: mean and scatter over targets, and amplitudes without its bias."""

from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, estimate_waveform, fit_sharp, measure_frame
from labdaemon.blur.phase.shared_waveform import SharedWaveform
from labdaemon.blur.phase.third_harmonic import LEAST, ThirdHarmonic, third_harmonic
from labdaemon.blur.phase.unknown_window import UnknownWindow, estimate_window, window_gain
from labdaemon.blur.phase.waveform_series import ORDERS, window_series
from labdaemon.blur.phase.window_evidence import WaveformEvidence

STILL = Defocus(0.0, 0.02)
VECTORS = ((4.0, 1.0), (-2.0, 5.0), (1.0, 1.4))


class Named:
    """What stands for a target and its fit where only equations matter."""

    def __init__(self, name: str) -> None:
        self.name, self.sharp, self.chi2 = name, self, 0.9


def evidence(values: list[float], sds: list[float], series: np.ndarray | None = None) -> list[WaveformEvidence]:
    """Equations that ask for harmonics of these values, or for an exposure's series."""
    found = []
    for index, (value, sd) in enumerate(zip(values, sds, strict=True)):
        information = np.eye(ORDERS + 1) * sd**-2
        wanted = np.append(np.zeros(ORDERS) if series is None else series, value)
        named = Named(f"T{index}")
        found.append(
            WaveformEvidence(named, named, information, information @ wanted, np.zeros((2, ORDERS + 1)))  # type: ignore[arg-type]
        )
    return found


def test_nothing_is_seen_where_there_is_nothing() -> None:
    rng = np.random.default_rng(1)
    sds = [0.002, 0.004, 0.01, 0.003]
    shown = [third_harmonic(evidence(list(rng.normal(0, sds)), sds)) for _ in range(200)]
    assert shown == [None] * 200
    assert third_harmonic([]) is None


def test_what_is_known_well_and_too_small_to_matter_is_left_out() -> None:
    assert third_harmonic(evidence([0.8 * LEAST] * 3, [1e-4] * 3)) is None


def test_residuals_of_another_kind_are_no_harmonic() -> None:
    assert third_harmonic(evidence([0.6, 0.5], [0.01, 0.01])) is None


def test_a_common_harmonic_is_the_mean_and_others_get_it() -> None:
    found = third_harmonic(evidence([0.051, 0.048, 0.06], [0.002, 0.002, 0.02]))
    assert found is not None
    assert found.mean == pytest.approx(0.0495, abs=1e-3)
    other = found.of("X")
    assert other.cosine == (0.0, found.mean)
    assert other.sd[1] == found.scatter < 0.004
    # A poorly known one of its own is drawn to the mean.
    assert abs(found.of("T2").cosine[1] - found.mean) < 1e-3
    assert found.of("T0").sd[1] < found.scatter


def test_harmonics_that_differ_leave_the_others_uncertain() -> None:
    found = third_harmonic(evidence([0.08, -0.02, 0.03], [0.002] * 3))
    assert found is not None
    assert found.scatter > 0.04
    assert found.of("T0").cosine[1] == pytest.approx(0.08, abs=1e-3)


def test_a_single_target_says_nothing_of_the_others() -> None:
    found = third_harmonic(evidence([0.05], [0.001]))
    assert found is not None
    assert found.of("T0").cosine[1] == pytest.approx(0.05, abs=1e-3)
    assert found.scatter >= 0.05


def test_the_quadrature_part_is_in_the_standard_deviation() -> None:
    assert SharedWaveform(harmonic=ThirdHarmonic({}, 0.05, 0.0, 100.0)).relative_sd == pytest.approx(0.00125)
    assert SharedWaveform().relative_sd == 0.0
    exposure = UnknownWindow(3.4, 0.01, 0.002)
    assert SharedWaveform(exposure).relative_sd == 0.002
    assert SharedWaveform(exposure).window == exposure.window


def test_equations_of_an_exposure_and_of_a_harmonic_are_told_apart() -> None:
    part = window_series(np.array(2 * np.pi * 5.4), np.array(0.6))
    asked = evidence([0.0, 0.0], [0.003, 0.003], part)
    assert third_harmonic(asked) is None
    assert window_gain(asked) > 100
    assert window_gain(evidence([0.05, 0.05], [0.002, 0.002])) < 5


def test_a_rough_exposure_takes_the_part_that_the_targets_show() -> None:
    weak = evidence([0.0], [0.05], window_series(np.array(2 * np.pi * 5.4), np.array(0.6)))
    free, known = estimate_window(weak), estimate_window(weak, (5.0, 0.02))
    assert free.cycles is None
    assert known.cycles is None
    assert 0 < known.relative_sd < free.relative_sd


@pytest.fixture(scope="module")
def frame(area):  # type: ignore[no-untyped-def]
    """Three dots, sharp, and moving with 5 % of the third harmonic."""
    scene = area.Scene()
    places = [(34.2, 33.1), (33.7, 34.4), (34.5, 33.6)]
    sharps, patches = [], []
    for index, (place, (vx, vy)) in enumerate(zip(places, VECTORS, strict=True)):

        def path(t, vx=vx, vy=vy):  # type: ignore[no-untyped-def]
            angle = 2 * np.pi * t
            course = np.sin(angle) + 0.05 * np.sin(3 * angle)
            return vx * course, vy * course

        still = area.render(scene, (68, 68), place, seed=50 + index)
        sharps.append(fit_sharp(Dot(*place, 15.7, 15.7, 0.0, name=f"T{index}"), [still], noise=scene.noise))
        patches.append(area.render(scene, (68, 68), place, path, seed=90 + index, samples=90))
    return sharps, patches


@pytest.mark.parametrize("whole", [True, False])
def test_amplitudes_lose_the_bias_of_the_harmonic(frame, whole: bool) -> None:  # type: ignore[no-untyped-def]
    sharps, patches = frame
    first = measure_frame(sharps, patches, defocus=STILL)
    found = estimate_waveform(sharps, patches, first, defocus=STILL, whole=whole)
    assert found.window is None
    assert found.harmonic is not None
    assert found.harmonic.mean == pytest.approx(0.05, abs=0.005)
    last = measure_frame(sharps, patches, defocus=STILL, harmonics=[found.harmonic.of(one.name) for one in sharps])
    sizes = np.hypot(*np.transpose(VECTORS))
    errors = np.array([[one.amplitude_px for one in each] / sizes - 1 for each in (first, last)])
    assert np.abs(errors[0]).max() > 3e-3 > np.abs(errors[1][:2]).max()
    assert abs(errors[1][2]) * sizes[2] < 4 * last[2].sd_px
    assert not any(one.flags for one in last)


def test_only_long_straight_paths_are_asked(frame) -> None:  # type: ignore[no-untyped-def]
    sharps, patches = frame
    first = measure_frame(sharps, patches, defocus=STILL)
    curved = [replace(one, b_px=0.5 * one.a_px[::-1]) for one in first]
    assert estimate_waveform(sharps, patches, curved, defocus=STILL, whole=True) == SharedWaveform()
