import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, ExposureWindow, find_relative_signs, fit_sharp
from labdaemon.blur.phase.signs import _GRID, PhaseLikelihood, combine_likelihoods, decide_sign
from labdaemon.blur.waveform import quadrature_transfer, window_nodes
from labdaemon.errors import UsageError

STILL = Defocus(0.0, 0.01)
CYCLES = 5.5
WINDOW = ExposureWindow(5.5, 1.0)


def blur_of(window: ExposureWindow, v: np.ndarray, middle_rad: float) -> np.ndarray:
    """Transfer function of v·sin μ at the middle of the exposure, its mean place at the origin."""
    fx, fy = np.meshgrid(np.linspace(0, 0.4, 9), np.linspace(-0.4, 0.4, 17))
    basis, weight = window_nodes(window, 12.0)
    psi = middle_rad - np.pi * window.cycles
    course = np.cos(psi) * basis[0] + np.sin(psi) * basis[1]
    transfer, _ = quadrature_transfer(fx, fy, v, course[None], weight)
    return transfer * np.exp(2j * np.pi * (fx * v[0] + fy * v[1]) * (course @ weight))


@pytest.mark.parametrize("cycles", [0.37, 0.8, 2.4, 5.37, 5.5])
def test_the_four_motions_of_one_image(cycles):
    v, window = np.array([2.0, -0.7]), ExposureWindow(cycles, 1.0)
    for mu in (0.2, 0.9, 1.4):
        same = [blur_of(window, *pair) for pair in ((v, mu), (v, np.pi - mu), (-v, -mu), (-v, np.pi + mu))]
        for other in same[1:]:
            np.testing.assert_allclose(other, same[0], atol=1e-9)
        assert np.abs(blur_of(window, -v, mu) - same[0]).max() > 1e-3


def test_no_sign_over_whole_cycles_or_about_the_mean_position():
    v = np.array([2.0, -0.7])
    np.testing.assert_allclose(
        blur_of(ExposureWindow(5.0, 1.0), v, 1.0), blur_of(ExposureWindow(5.0, 1.0), -v, 1.0), atol=1e-9
    )
    np.testing.assert_allclose(
        blur_of(ExposureWindow(5.4, 1.0), v, 0.0), blur_of(ExposureWindow(5.4, 1.0), -v, 0.0), atol=1e-9
    )


@pytest.mark.parametrize("cycles", [0.3, 1.2, 5.5, 7.1])
def test_the_skew_shows_the_sine_for_any_window(cycles):
    """The third moment has the sign of -sin μ·sin(Θ/2) all round."""
    basis, weight = window_nodes(ExposureWindow(cycles, 1.0), 3.0)
    for mu in np.linspace(0.05, np.pi - 0.05, 9):
        psi = mu - np.pi * cycles
        course = np.cos(psi) * basis[0] + np.sin(psi) * basis[1]
        third = float(weight @ (course - weight @ course) ** 3)
        assert third * np.sin(np.pi * cycles) < 0


def likelihood(middle_deg: float, sd_deg: float, orbit: bool = False) -> PhaseLikelihood:
    cost = ((np.degrees(_GRID) - middle_deg) / sd_deg) ** 2
    return PhaseLikelihood(np.array([1.0, 0.2]), cost, orbit)


def test_signs_of_targets_that_share_a_phase():
    found = combine_likelihoods(
        [likelihood(40, 1), likelihood(-41, 1), likelihood(39, 4), likelihood(-40, 8), likelihood(42, 300), None],
        WINDOW,
    )
    np.testing.assert_array_equal(found.sign, [1, -1, 1, -1, 0, 0])
    assert abs(np.degrees(found.mid_exposure_phase_rad) - 40) < 2
    assert np.degrees(found.sd_mid_exposure_phase_rad) < 2
    np.testing.assert_array_equal(found.vector_px[1], [-1.0, -0.2])
    assert np.isnan(found.vector_px[5]).all()
    assert [decide_sign(one) for one in found.evidence] == list(found.sign)


def test_another_phase_an_orbit_and_a_wave_have_no_sign():
    mode = [likelihood(s * 60, 1) for s in (1, -1, 1, 1, -1, 1)]
    found = combine_likelihoods([*mode, likelihood(20, 1), likelihood(60, 1, orbit=True)], WINDOW)
    np.testing.assert_array_equal(found.sign, [1, -1, 1, 1, -1, 1, 0, 0])
    wave = combine_likelihoods([likelihood(angle, 1) for angle in range(-80, 90, 20)], WINDOW)
    assert not wave.sign.any()
    assert np.isnan(wave.mid_exposure_phase_rad)


def test_about_the_mean_position_nothing_is_said():
    found = combine_likelihoods([likelihood(s * 0.5, 1) for s in (1, -1, 1, -1)], WINDOW)
    assert not found.sign.any()


def test_a_known_opening_leaves_two_phases():
    found = combine_likelihoods([likelihood(30, 0.5)] * 5, ExposureWindow(5.5, 1.0, 0.4))
    middle = np.array(found.phase_rad) + 0.4 + np.pi * 5.5
    np.testing.assert_allclose(np.sin(middle), 0.5, atol=0.02)
    assert abs(np.cos(middle).sum()) < 1e-6


@pytest.mark.parametrize("seed", [1])
def test_from_pictures(area, seed):
    """Four in one phase, one a third of a cycle off, one that turns, one too small."""
    scene = area.Scene(radius_px=12.0)
    rest = area.render(scene, (60, 60), (30.2, 29.7), seed=seed)
    sharp = fit_sharp(Dot(30, 30, 12, 12, 0.0, name="t"), [rest], noise=scene.noise)
    phase = 0.3 - np.pi * CYCLES  # at the middle: 0.3 rad + a quarter turn
    c, s = np.cos(phase + np.pi / 2), np.sin(phase + np.pi / 2)
    along = [(4.0, 1.0), (-4.0, -1.0), (2.5, -2.0), (-1.0, 3.0)]
    motions = [(x * c, y * c, x * s, y * s) for x, y in along]
    c2, s2 = np.cos(phase), np.sin(phase)
    motions += [(4.0 * c2, 0.5 * c2, 4.0 * s2, 0.5 * s2), (3.0, 0.0, 0.0, 1.5), (0.2 * c, 0.0, 0.2 * s, 0.0)]
    images = [
        area.render(scene, (72, 76), (38.1, 36), area.part_cycles(*m, CYCLES, 0.0), seed=10 * seed + i, samples=440)
        for i, m in enumerate(motions)
    ]
    found = find_relative_signs([sharp] * len(images), images, WINDOW, defocus=STILL)
    assert np.all(found.sign[:4] != 0)
    assert not found.sign[4:].any()
    for got, true in zip(found.vector_px[:4], along, strict=True):
        np.testing.assert_allclose(got, np.array(true), atol=0.1)
    assert abs(found.mid_exposure_phase_rad - (np.pi / 2 - 0.3)) < 0.15


def test_one_patch_a_target(area):
    with pytest.raises(UsageError, match="patch"):
        find_relative_signs([], [area.render(area.Scene(), (40, 40), (20, 20))], WINDOW)
