"""Bessel functions from a table against the exact ones."""

import numpy as np
import pytest
from scipy import special

from labdaemon.blur.settings import CACHE
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.spectra.bessel import j0_j1


def test_the_table_is_good_to_a_hundred_thousandth():
    z = np.random.default_rng(1).uniform(0, CACHE.bessel_max, 20_000).astype(np.float32)
    j0, j1 = j0_j1(z)
    assert j0.dtype == j1.dtype == np.float32
    exact = z.astype(np.float64)
    assert np.max(np.abs(j0 - special.j0(exact))) < 1e-5
    assert np.max(np.abs(j1 - special.j1(exact))) < 1e-5


def test_j1_over_its_argument_keeps_its_limit_near_zero():
    z = np.geomspace(1e-4, 0.1, 200).astype(np.float32)
    np.testing.assert_allclose(j0_j1(z)[1] / z, special.j1(z.astype(np.float64)) / z, atol=2e-4)


@pytest.mark.parametrize("values", [[0.3, 900.0], [0.3, np.nan], []])
def test_what_the_table_does_not_hold_is_computed(values):
    z = np.array(values, dtype=np.float32)
    np.testing.assert_array_equal(j0_j1(z)[0], special.j0(z))


def test_double_precision_stays_exact():
    z = np.linspace(0, 50, 1001)
    np.testing.assert_array_equal(j0_j1(z)[1], special.j1(z))


@pytest.mark.parametrize("motion", [closed_form.straight_transfer, closed_form.orbit_transfer])
def test_transfer_functions_agree_in_both_precisions(motion):
    fx, fy = np.meshgrid(np.linspace(0, 0.5, 31), np.linspace(-0.5, 0.5, 40))
    p = np.array([9.0, -4.0]) if motion is closed_form.straight_transfer else np.array([81.0, -20.0, 30.0])
    exact, slopes = motion(fx, fy, p)
    quick, quick_slopes = motion(fx.astype(np.float32), fy.astype(np.float32), p)
    assert quick.dtype == quick_slopes.dtype == np.float32
    np.testing.assert_allclose(quick, exact, atol=1e-4)
    np.testing.assert_allclose(quick_slopes, slopes, atol=2e-3 * np.max(np.abs(slopes)))
