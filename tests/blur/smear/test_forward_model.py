"""The modelled image and its derivatives."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from labdaemon.blur import Dot, fit_sharp
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import prepare_fit
from labdaemon.blur.smear.forward_model import dwell_density, forward_model
from labdaemon.blur.spectra import closed_form

START = np.array([0.05, 0.002, -0.001, 0.001, 0.003, 5.0, -2.0])


def problem_of(area, **scene):
    scene = area.Scene(radius_px=9.4, airy_px=(1.7, 1.4, 1.4, 1.1), white_dn=(2500.0,) * 4, bayer=True, **scene)
    sharp_patch = area.render(scene, (50, 50), (25.2, 24.9), seed=1)
    sharp = fit_sharp(Dot(25.0, 25.0, 9.4, 9.4, 0.0, name="t"), [sharp_patch], noise=scene.noise)
    patch = area.render(scene, (60, 66), (33.1, 30.3), area.whole_cycles(5, -2), seed=2)
    problem = prepare_fit(sharp, patch, np.array([33.0, 30.0]))
    assert problem is not None
    return problem


@pytest.fixture(scope="module")
def problem(area):
    return problem_of(area, offset_px=((0.15, 0), (0, 0), (0, 0), (-0.15, 0.1)))


def differences(model, p, step=1e-2):
    columns = []
    for index in range(len(p)):
        up, down = p.copy(), p.copy()
        up[index] += step
        down[index] -= step
        columns.append((model(up)[0].astype(float) - model(down)[0].astype(float)) / (2 * step))
    return np.array(columns)


def test_the_transform_of_the_arcsine_law_is_j0():
    place = np.cos(np.pi * (np.arange(4000) + 0.5) / 4000) * 3.0  # equal probabilities, by the law's own quantiles
    edges = np.linspace(-3.0, 3.0, 61)
    share = np.histogram(place, edges)[0] / 4000
    middle = (edges[1:-2] + edges[2:-1]) / 2
    np.testing.assert_allclose(share[1:-1], dwell_density(middle, 3.0) * 0.1, rtol=0.03)
    assert np.mean(np.exp(-2j * np.pi * 0.21 * place)).real == pytest.approx(
        special.j0(2 * np.pi * 0.21 * 3.0), abs=1e-6
    )
    assert not dwell_density(np.array([-3.1, 3.0]), 3.0).any()


@pytest.mark.parametrize(
    ("transfer_function", "motion"),
    [
        (None, ()),
        (closed_form.straight_transfer, (5.0, -2.0)),
        (closed_form.orbit_transfer, (25.0, -10.0, 6.0)),
    ],
)
def test_the_fast_model_is_equation_1(problem, transfer_function, motion):
    p = np.concatenate((problem.initial_centre_px, START[:5], motion))
    darkness, by_p = forward_model(problem, transfer_function)(p)
    fast, fast_by_p = fast_forward_model(problem, transfer_function, exact=True)(p)
    np.testing.assert_allclose(fast, darkness, atol=2e-5)
    for own, other in zip(fast_by_p, by_p, strict=True):
        np.testing.assert_allclose(own, other, atol=2e-4 * max(np.max(np.abs(other)), 0.1))


def test_exact_derivatives_are_those_of_the_image(problem):
    p = np.concatenate((problem.initial_centre_px, START))
    model = fast_forward_model(problem, closed_form.straight_transfer, exact=True)
    _, by_p = model(p)
    expected = differences(model, p)
    for own, other in zip(by_p, expected, strict=True):
        np.testing.assert_allclose(own, other, atol=0.02 * np.max(np.abs(other)))


def test_shared_derivatives_differ_by_little_and_the_image_not_at_all(problem):
    p = np.concatenate((problem.initial_centre_px, START))
    dark, by_p = fast_forward_model(problem, closed_form.straight_transfer)(p)
    exact_dark, exact = fast_forward_model(problem, closed_form.straight_transfer, exact=True)(p)
    np.testing.assert_allclose(dark, exact_dark, atol=1e-5)
    for own, other in zip(by_p, exact, strict=True):
        likeness = np.vdot(own, other) / np.sqrt(np.vdot(own, own) * np.vdot(other, other))
        assert likeness > 0.99


def test_spectra_at_rest_are_kept_for_the_next_frame_and_for_copies_of_the_target(area):
    scene = area.Scene(radius_px=9.4)
    sharp = fit_sharp(Dot(25.0, 25.0, 9.4, 9.4, 0.0, name="t"), [area.render(scene, (50, 50), (25.2, 24.9), seed=1)])
    patch = area.render(scene, (50, 50), (25.2, 24.9), seed=2)
    copy = pickle.loads(pickle.dumps(sharp))
    first, second = (prepare_fit(one, patch, np.array([25.0, 25.0])) for one in (sharp, copy))
    assert first is not None
    assert second is not None
    assert first.rest_spectra is second.rest_spectra
    larger = replace(sharp, form=replace(sharp.form, q_px=sharp.form.q_px * 1.001))
    third = prepare_fit(larger, patch, np.array([25.0, 25.0]))
    assert third is not None
    assert third.rest_spectra is not first.rest_spectra
