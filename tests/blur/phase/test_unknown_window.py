"""Cycles in an exposure that nothing states: what one look at each target says, and what several say together."""

import numpy as np
import pytest

from labdaemon.blur import Defocus, Measurement, estimate_waveform, fit_sharp, with_relative_sd
from labdaemon.blur.patch.pixels import Dot
from labdaemon.blur.phase.unknown_window import estimate_window
from labdaemon.blur.phase.waveform_series import (
    ORDERS,
    amplitude_error,
    free_window_transfer,
    series_transfer,
    window_series,
)

STILL = Defocus(0.0, 0.02)
FY, FX = np.meshgrid(np.fft.fftfreq(24), np.fft.fftfreq(24), indexing="ij")


def test_the_series_is_the_transfer_function_of_a_long_exposure() -> None:
    cycles, mu, v = 30.3, 0.7, np.array([1.1, -0.6])
    exact, _ = free_window_transfer(FX, FY, np.array([*v, mu, 2 * np.pi * cycles]))
    plain, slopes = series_transfer(FX, FY, np.array([*v, *np.zeros(ORDERS + 2)]))
    series = plain + np.tensordot(window_series(np.array(2 * np.pi * cycles), np.array(mu)), slopes[3:-1], axes=1)
    assert np.abs(series - exact).max() < 1e-4 < np.abs(plain - exact).max()


def test_the_third_harmonics_derivative() -> None:
    angle, v, step = 2 * np.pi * (np.arange(256) + 0.5) / 256, np.array([1.1, -0.6]), 1e-4
    courses = [np.sin(angle) + sign * step * np.sin(3 * angle) for sign in (1, -1)]
    z = 2 * np.pi * (v[0] * FX + v[1] * FY)[..., None]
    ends = [np.exp(-1j * z * course).mean(axis=-1) for course in courses]
    _, slopes = series_transfer(FX, FY, np.array([*v, *np.zeros(ORDERS + 2)]))
    np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slopes[-1], atol=2e-4)


def test_the_minor_axis_widens_the_path() -> None:
    angle, v, minor = 2 * np.pi * (np.arange(256) + 0.5) / 256, np.array([1.1, -0.6]), 0.02
    across = np.array([0.6, 1.1]) / np.hypot(*v)
    paths = [np.outer(v, np.sin(angle)) + np.outer(b * across, np.cos(angle)) for b in (minor, 0.0)]
    ends = [np.exp(-2j * np.pi * (FX[..., None] * x + FY[..., None] * y)).mean(axis=-1) for x, y in paths]
    _, slopes = series_transfer(FX, FY, np.array([*v, *np.zeros(ORDERS + 2)]))
    np.testing.assert_allclose((ends[0] - ends[1]) / minor**2, slopes[2], atol=4e-3)


def test_derivatives_of_the_free_window() -> None:
    p, step = np.array([1.4, 0.5, 0.4, 2 * np.pi * 3.3]), 1e-5
    _, slopes = free_window_transfer(FX, FY, p)
    for index, slope in enumerate(slopes):
        ends = [free_window_transfer(FX, FY, p + sign * step * np.eye(4)[index])[0] for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * step), slope, atol=1e-6)


def test_whole_cycles_have_no_amplitude_error_and_few_cycles_have_one() -> None:
    mu = np.linspace(-1.5, 1.5, 7)
    np.testing.assert_allclose(amplitude_error(np.array(2 * np.pi * 5), mu), 0, atol=1e-12)
    assert np.abs(amplitude_error(np.array(2 * np.pi * 2.3), mu)).max() > 0.01


@pytest.fixture(scope="module")
def frame(area):  # type: ignore[no-untyped-def]
    """Three dots, sharp, and a function that photographs them through an exposure, each at its own phase."""
    scene = area.Scene()
    places = [(34.2, 33.1), (33.7, 34.4), (34.5, 33.6)]
    vectors = np.array([[4.0, 1.0], [-2.0, 5.0], [1.5, 2.5]])
    sharps = [
        fit_sharp(
            Dot(*place, 15.7, 15.7, 0.0, name=f"T{index}"),
            [area.render(scene, (68, 68), place, seed=50 + index)],
            noise=scene.noise,
        )
        for index, place in enumerate(places)
    ]

    def photograph(cycles: float):  # type: ignore[no-untyped-def]
        patches = [
            area.render(
                scene, (68, 68), place, area.part_cycles(*v, 0, 0, cycles, 0.9 + index), seed=90 + index, samples=150
            )
            for index, (place, v) in enumerate(zip(places, vectors, strict=True))
        ]
        rough = [
            Measurement(f"T{index}", np.array(place), v, np.zeros(2), np.eye(6))
            for index, (place, v) in enumerate(zip(places, vectors, strict=True))
        ]
        return sharps, patches, rough

    return photograph


def test_targets_together_show_the_cycles(frame) -> None:  # type: ignore[no-untyped-def]
    found = estimate_waveform(*frame(3.4), defocus=STILL).exposure
    assert found is not None
    assert found.cycles is not None
    assert found.cycles == pytest.approx(3.4, abs=0.03)
    assert found.window is not None
    assert found.window.cycles == found.cycles
    assert found.sd_cycles < 0.02


def test_whole_cycles_are_not_excluded_and_leave_little_open(frame) -> None:  # type: ignore[no-untyped-def]
    found = estimate_waveform(*frame(5.0), defocus=STILL).exposure
    assert found is not None
    assert found.cycles is None
    assert found.window is None
    assert found.relative_sd < 2e-3


def test_without_evidence_the_standard_deviation_is_what_any_exposure_may_do() -> None:
    nothing = estimate_window([])
    assert nothing.cycles is None
    assert 4e-3 < nothing.relative_sd < 2e-2
    # A frequency and a shutter's nominal time say more.
    assert estimate_window([], (5.0, 0.02)).relative_sd < 0.5 * nothing.relative_sd


def test_a_relative_sd_widens_along_the_motion_only() -> None:
    one = Measurement("T", np.zeros(2), np.array([3.0, 0.0]), np.zeros(2), 1e-6 * np.eye(6))
    wide = with_relative_sd(one, 0.01)
    assert wide.sd_px == pytest.approx(np.hypot(0.03, 1e-3))
    assert wide.covariance_px2[3, 3] == 1e-6
    lost = Measurement("T", *[np.full(2, np.nan)] * 3, np.full((6, 6), np.nan))
    assert with_relative_sd(lost, 0.01) is lost
