"""The predicted standard deviation: against plain differences, against what a fit states, and in its limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur import (
    Defocus,
    Dot,
    DotImage,
    ExposureWindow,
    LightCode,
    NoiseModel,
    fit_sharp,
    measure_group,
    named_code,
    predict_sd,
)
from labdaemon.errors import UsageError

QUIET = DotImage(noise=NoiseModel(7.0 / 8.5, 1.0 / 8.5))
WHOLE = ExposureWindow(5.0, 1.0)


def coded(name: str, ambient: float = 0.0, **light: float) -> ExposureWindow:
    return ExposureWindow(5.0, 1.0, light=LightCode(named_code(name), 0.0, 5, ambient, **light))


def degrees(windows: list[ExposureWindow], amplitude_px: float, dot: DotImage = QUIET) -> list[float]:
    phases = np.arange(6) * np.pi / 6
    return [float(np.degrees(predict_sd(windows, amplitude_px, float(phase), dot).phase_rad)) for phase in phases]


def test_figures_of_the_prototype() -> None:
    one = degrees([coded("1110100")], 3.0)
    assert 0.15 < min(one) < 0.3
    assert 0.3 < np.median(one) < 0.45
    assert max(one) < 0.8
    pair = degrees([coded("cos"), coded("sin")], 3.0)
    assert max(pair) < 0.3
    two_windows = [ExposureWindow(5.0, 1.1, phase) for phase in (0.0, np.pi / 2)]
    assert 0.7 < np.median(degrees(two_windows, 3.0)) < 2.5


def test_whole_cycles_show_the_amplitude_alone() -> None:
    predicted = predict_sd([WHOLE], 3.0, 0.3, QUIET)
    assert predicted.phase_rad == np.inf
    assert predicted.amplitude_px == pytest.approx(0.004, rel=0.4)
    assert np.all(np.isinf(np.diag(predicted.covariance_px2)))


def test_two_equal_captures_are_better_by_the_root_of_two() -> None:
    one, two = (predict_sd([coded("1110100")] * count, 3.0, 0.3, QUIET) for count in (1, 2))
    assert two.amplitude_px == pytest.approx(one.amplitude_px / np.sqrt(2), rel=1e-6)
    assert two.phase_rad == pytest.approx(one.phase_rad / np.sqrt(2), rel=1e-6)


def test_texture_ambient_light_and_their_uncertainty_cost_precision() -> None:
    def phase(window: ExposureWindow, dot: DotImage = QUIET) -> float:
        return predict_sd([window], 3.0, 1.0, dot).phase_rad

    plain = phase(coded("1110100"))
    assert plain < phase(coded("1110100"), DotImage()) < 1.3 * plain
    half = phase(coded("1110100", 0.5))
    assert 1.3 * plain < half < phase(coded("1110100", 0.5, sd_ambient=0.05))
    assert plain < phase(coded("1110100", sd_phase_rad=0.01))
    assert phase(coded("1110100", sd_phase_rad=0.01)) == pytest.approx(np.hypot(plain, 0.01), rel=0.01)


def test_texture_that_sharp_frames_show_costs_less_and_a_lens_shows_less_of_it() -> None:
    noise = NoiseModel(7.0 / 8.5, 1.0 / 8.5, 0.008, 0.83)
    seen = noise.seen_through(1.25)
    assert seen.texture * seen.texture_px == pytest.approx(0.008 * 0.83)
    assert seen.texture_px == pytest.approx(1.53, abs=0.01)
    sd = [predict_sd([WHOLE], 12.0, 0.3, DotImage(noise=seen, sharp_frames=count)).amplitude_px for count in (9, 1, 0)]
    assert predict_sd([WHOLE], 12.0, 0.3, QUIET).amplitude_px < sd[0] < sd[1] < 0.95 * sd[2]


def test_diffraction_shows_less_than_a_gaussian_of_its_width() -> None:
    gaussian, airy = DotImage(lens_sigma_px=1.25), DotImage(lens_sigma_px=0.13, diffraction_px=2.8)
    ratio = [predict_sd([WHOLE], 6.0, 0.3, dot).amplitude_px for dot in (airy, gaussian)]
    assert 1.1 < ratio[0] / ratio[1] < 1.3


def test_timing_of_part_cycles_counts() -> None:
    exact = [ExposureWindow(5.0, 1.1, phase) for phase in (0.0, np.pi / 2)]
    loose = [replace(window, sd_phase_rad=0.05, sd_exposure_s=1e-3) for window in exact]
    assert predict_sd(loose, 6.0, 0.4, QUIET).phase_rad > 1.2 * predict_sd(exact, 6.0, 0.4, QUIET).phase_rad


@settings(max_examples=8, deadline=None)
@given(st.floats(0.0, np.pi), st.floats(0.0, 2 * np.pi), st.sampled_from(["1110100", "cos"]))
def test_covariance_says_the_same_as_amplitude_and_phase(direction: float, phase: float, name: str) -> None:
    predicted = predict_sd([coded(name, 0.1), coded("1110100")], 2.0, phase, QUIET, direction_rad=direction)
    u = np.array([np.cos(direction), np.sin(direction)])
    along = np.concatenate((u * np.cos(phase), u * np.sin(phase)))
    across = np.concatenate((-u * np.sin(phase), u * np.cos(phase)))
    for slope, sd in ((along, predicted.amplitude_px), (across, 2.0 * predicted.phase_rad)):
        assert np.sqrt(slope @ predicted.covariance_px2 @ slope) == pytest.approx(sd, rel=1e-6)
    turned = predict_sd([coded(name, 0.1), coded("1110100")], 2.0, phase + np.pi, QUIET, direction_rad=direction)
    assert turned.phase_rad == pytest.approx(predicted.phase_rad, rel=1e-3)


def test_a_fit_states_what_was_predicted(area) -> None:
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)]
    )
    code = named_code("1110100")
    theta = (np.arange(7000) + 0.5) / 7000 * 2 * np.pi
    lit = theta[np.asarray(code)[(theta / (2 * np.pi) * 7).astype(int)] > 0]

    def path(t):
        angle = lit[np.minimum((np.asarray(t) * lit.size).astype(int), lit.size - 1)]
        return 2.4 * np.sin(angle + 0.4), 1.8 * np.sin(angle + 0.4)

    image = area.render(scene, (61, 61), (30.6, 30.5), path, seed=5, samples=300)
    window = ExposureWindow(5.0, 1.0, light=LightCode(code, 0.0, 5))
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.1))
    white = float(np.quantile(image.values, 0.9))
    # The renderer exposes a coded image as brightly as any other, so that the lamp was brighter by 7/4.
    dot = DotImage(12.0, 0.8, white * 7 / 4, 0.06, scene.noise)
    predicted = predict_sd([window], 3.0, 0.4, dot, direction_rad=float(np.arctan2(1.8, 2.4)))
    # Along the motion: across it the fit takes a straight path for granted, the prediction does not.
    along = np.concatenate((np.array([0.8, 0.6]) * np.cos(0.4), np.array([0.8, 0.6]) * np.sin(0.4)))
    later = np.concatenate((-np.array([0.8, 0.6]) * np.sin(0.4), np.array([0.8, 0.6]) * np.cos(0.4)))
    for slope, sd in ((along, predicted.amplitude_px), (later, 3.0 * predicted.phase_rad)):
        assert np.sqrt(slope @ found.covariance_px2[2:, 2:] @ slope) == pytest.approx(sd, rel=0.3)


@pytest.mark.parametrize(("windows", "amplitude"), [([], 1.0), ([WHOLE], 0.0), ([WHOLE], float("nan"))])
def test_what_cannot_be_predicted_is_refused(windows: list[ExposureWindow], amplitude: float) -> None:
    with pytest.raises(UsageError):
        predict_sd(windows, amplitude, 0.0)
