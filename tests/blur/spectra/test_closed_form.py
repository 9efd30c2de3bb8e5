import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.blur.patch.colour_planes import make_grid, sample_plane
from labdaemon.blur.spectra import closed_form

SMALL = settings(max_examples=25, deadline=None)


def numeric(function, p, index, step=1e-5):
    up, down = np.array(p, float), np.array(p, float)
    up[index] += step
    down[index] -= step
    return (function(up) - function(down)) / (2 * step)


@SMALL
@given(st.floats(3, 30), st.floats(3, 30), st.floats(-2, 2))
def test_ellipse_covers_its_area_and_its_derivatives_agree_with_differences(q0, q2, q1):
    q = np.array([q0, q1, q2])
    fx, fy = np.meshgrid(np.linspace(0.013, 0.4, 5), np.linspace(-0.4, 0.4, 6))
    zero = closed_form.ellipse_spectrum(np.array([[0.0]]), np.array([[0.0]]), q)[0][0, 0]
    assert zero == pytest.approx(np.pi * (q0 * q2 - q1**2), rel=1e-6)
    _, slopes = closed_form.ellipse_spectrum(fx, fy, q)
    for index in range(3):
        expected = numeric(lambda p: closed_form.ellipse_spectrum(fx, fy, p)[0], q, index)
        np.testing.assert_allclose(slopes[index], expected, atol=2e-5 * np.pi * q0 * q2)


@SMALL
@given(st.floats(0.1, 20), st.floats(0, np.pi), st.floats(0, 10), st.floats(0, 0.5), st.floats(-0.5, 0.5))
def test_orbit_is_the_mean_over_time_of_the_shifted_phase(size, angle, minor, fx, fy):
    a = size * np.array([np.cos(angle), np.sin(angle)])
    b = minor * np.array([-np.sin(angle), np.cos(angle)])
    t = 2 * np.pi * (np.arange(4000) + 0.5) / 4000
    path = np.outer(np.sin(t), a) + np.outer(np.cos(t), b)
    expected = np.mean(np.exp(-2j * np.pi * (path @ np.array([fx, fy])))).real
    moment = np.outer(a, a) + np.outer(b, b)
    got, _ = closed_form.orbit_transfer(
        np.array([[fx]]), np.array([[fy]]), np.array([moment[0, 0], moment[0, 1], moment[1, 1]])
    )
    assert got[0, 0] == pytest.approx(expected, abs=1e-9)


def test_orbit_goes_on_smoothly_through_rest():
    fx, fy = np.full((1, 1), 0.2), np.full((1, 1), 0.1)
    values = [closed_form.orbit_transfer(fx, fy, np.array([m, 0.0, m]))[0][0, 0] for m in (-1e-3, 0.0, 1e-3)]
    assert values[1] == 1.0
    assert values[0] - values[1] == pytest.approx(values[1] - values[2], rel=1e-3)


def test_diffraction_is_the_overlap_of_two_shifted_discs():
    y, x = np.mgrid[-600:601, -600:601] / 500.0
    disc = (x * x + y * y <= 1).astype(float)
    for nu in (0.1, 0.4, 0.8):
        shift = round(2 * nu * 500)
        overlap = float((disc[:, shift:] * disc[:, : disc.shape[1] - shift]).sum() / disc.sum())
        assert closed_form.diffraction_transfer(np.array([nu]), 1.0)[0] == pytest.approx(overlap, abs=2e-3)


@SMALL
@given(st.integers(12, 40), st.integers(12, 40), st.sampled_from([1, 2]), st.sampled_from([1, 2]))
def test_folding_on_a_lattice_samples_the_same_picture(height, width, period, oversampling):
    grid = make_grid((height, width), oversampling)
    f2 = grid.fx**2 + grid.fy**2
    blob = np.exp(-2 * np.pi**2 * 1.5**2 * f2) * np.exp(-2j * np.pi * (grid.fx * 5.3 + grid.fy * 6.1))
    values = sample_plane(blob, grid, period)
    y, x = np.mgrid[0 : grid.size[0] : period, 0 : grid.size[1] : period]
    near = (np.abs(x - 5.3) < 5) & (np.abs(y - 6.1) < 5)
    expected = np.exp(-((x - 5.3) ** 2 + (y - 6.1) ** 2) / (2 * 1.5**2)) / (2 * np.pi * 1.5**2)
    np.testing.assert_allclose(values[near], expected[near], atol=2e-5)
