"""The modelled image and its derivatives."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import Dot, fit_sharp
from labdaemon.blur.smear.forward_model import forward_model, prepare_fit
from labdaemon.blur.spectra import closed_form

START = np.array([0.05, 0.002, -0.001, 0.001, 0.003, 5.0, -2.0])


def setting_of(area, **scene):
    scene = area.Scene(radius_px=9.4, airy_px=(1.7, 1.4, 1.4, 1.1), white_dn=(2500.0,) * 4, bayer=True, **scene)
    sharp_patch = area.render(scene, (50, 50), (25.2, 24.9), seed=1)
    sharp = fit_sharp(Dot(25.0, 25.0, 9.4, 9.4, 0.0, name="t"), [sharp_patch], noise=scene.noise)
    patch = area.render(scene, (60, 66), (33.1, 30.3), area.whole_cycles(5, -2), seed=2)
    problem = prepare_fit(sharp, patch, np.array([33.0, 30.0]))
    assert problem is not None
    return problem


@pytest.fixture(scope="module")
def problem(area):
    return setting_of(area, offset_px=((0.15, 0), (0, 0), (0, 0), (-0.15, 0.1)))


def differences(model, p, step=1e-2):
    columns = []
    for index in range(len(p)):
        up, down = p.copy(), p.copy()
        up[index] += step
        down[index] -= step
        columns.append((model(up)[0].astype(float) - model(down)[0].astype(float)) / (2 * step))
    return np.array(columns)


def test_exact_derivatives_are_those_of_the_picture(problem):
    p = np.concatenate((problem.initial_centre_px, START))
    model = forward_model(problem, closed_form.straight_transfer, exact=True)
    _, by_p = model(p)
    expected = differences(model, p)
    for own, other in zip(by_p, expected, strict=True):
        np.testing.assert_allclose(own, other, atol=0.02 * np.max(np.abs(other)))


def test_shared_derivatives_differ_by_little_and_the_picture_not_at_all(problem):
    p = np.concatenate((problem.initial_centre_px, START))
    dark, by_p = forward_model(problem, closed_form.straight_transfer)(p)
    exact_dark, exact = forward_model(problem, closed_form.straight_transfer, exact=True)(p)
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
