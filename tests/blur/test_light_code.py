"""Coded light: transfer function against plain integration, twins of codes, and the phase from one image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import labdaemon.blur.light_code
import labdaemon.blur.waveform
from labdaemon.blur import (
    Defocus,
    Dot,
    ExposureWindow,
    InitialGuess,
    LightCode,
    fit_sharp,
    measure_group,
    mirror_axes,
    named_code,
)
from labdaemon.blur.waveform import window_nodes
from labdaemon.errors import UsageError
from labdaemon.flags import Flag

SEVEN = named_code("1110100")


def integrated(window: ExposureWindow, fa: float, fb: float) -> complex:
    """H at f·a, f·b (cycles), by the mean over 200 000 instants of lamp and ambient light."""
    assert window.light is not None
    light = window.light
    theta = (np.arange(200_000) + 0.5) / 200_000 * 2 * np.pi
    lamp = light.at(theta)
    seen = np.exp(-2j * np.pi * (fa * np.sin(theta) + fb * np.cos(theta)))
    total = light.cycles * lamp.mean() + light.ambient * window.cycles
    opened = (window.phase_rad or 0.0) + (np.arange(200_000) + 0.5) / 200_000 * 2 * np.pi * window.cycles
    room = np.exp(-2j * np.pi * (fa * np.sin(opened) + fb * np.cos(opened)))
    return complex((light.cycles * (lamp * seen).mean() + light.ambient * window.cycles * room.mean()) / total)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.sampled_from([0.0, 0.3, 1.0]), min_size=2, max_size=12).filter(lambda code: max(code) > 0),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.05),
    st.floats(-2.0, 2.0),
    st.floats(-2.0, 2.0),
)
def test_nodes_integrate_the_light_over_the_cycle(
    code: list[float], phase: float, ambient: float, rise: float, fa: float, fb: float
) -> None:
    light = LightCode(tuple(code), phase, 4, ambient, rise)
    window = ExposureWindow(5.0, 1.0, 0.7, light=light)
    basis, weight = window_nodes(window, 6.0)
    assert weight.sum() == pytest.approx(1.0)
    transfer = np.sum(weight * np.exp(-2j * np.pi * (fa * basis[0] + fb * basis[1])))
    assert abs(transfer - integrated(window, fa, fb)) < 2e-4


@pytest.mark.parametrize("sectors", [17, 31, 64])
@pytest.mark.parametrize("amplitude", [0.5, 3.0, 12.0])
def test_many_sectors_are_integrated_by_their_harmonics(sectors: int, amplitude: float) -> None:
    levels = np.random.default_rng(sectors).uniform(0, 1, sectors)
    light = LightCode(tuple(levels), 0.7, 3, 0.2, 0.03)
    window = ExposureWindow(5.0, 0.7, 0.4, light=light)
    basis, weight = window_nodes(window, amplitude)
    assert weight.sum() == pytest.approx(1.0)
    assert weight.size < 110 + 12 * amplitude
    for f in (0.05, 0.25, 0.5):
        fa, fb = amplitude * f * np.cos(1.1), amplitude * f * np.sin(1.1)
        transfer = np.sum(weight * np.exp(-2j * np.pi * (fa * basis[0] + fb * basis[1])))
        assert abs(transfer - integrated(window, fa, fb)) < 3e-4


def test_even_light_is_the_arcsine_law() -> None:
    even = ExposureWindow(5.0, 1.0, light=LightCode((1.0, 1.0, 1.0), 0.3, 5))
    assert not even.is_coded
    coded, plain = window_nodes(even, 4.0), window_nodes(ExposureWindow(5.0, 1.0), 4.0)
    for f in (0.1, 0.7):
        values = [np.sum(weight * np.exp(-2j * np.pi * 3 * f * basis[0])) for basis, weight in (coded, plain)]
        assert abs(values[0] - values[1]) < 1e-6


def test_symmetric_codes_have_a_twin_and_the_seven_sector_code_has_none() -> None:
    assert mirror_axes(LightCode(named_code("11010")))
    assert mirror_axes(LightCode(named_code("1100")))
    [axis] = mirror_axes(LightCode(named_code("cos")), least_likeness=0.999)
    assert abs(np.sin(axis)) < 0.05
    assert not mirror_axes(LightCode(SEVEN))
    # The twin of a symmetric code leaves the same image: H is the same for the motion run backwards from the axis.
    code = LightCode(named_code("11010"), 0.4)
    axis = mirror_axes(code)[0]
    a, b = 0.8, -0.5
    m, w = a * np.sin(axis) + b * np.cos(axis), a * np.cos(axis) - b * np.sin(axis)
    twin = m * np.sin(axis) - w * np.cos(axis), m * np.cos(axis) + w * np.sin(axis)
    window = ExposureWindow(1.0, 1.0, light=code)
    assert abs(integrated(window, a, b) - integrated(window, *twin)) < 2e-3


@pytest.mark.parametrize("code", [(), (1.0,), (0.0, 0.0), (0.5, 1.5), (1.0, float("nan"))])
def test_codes_that_are_none_are_refused(code: tuple[float, ...]) -> None:
    with pytest.raises(UsageError):
        LightCode(code)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="is no code"):
        named_code("11x0")


def render_coded(area, scene, code, motion, seed, size):
    """The dot under coded light: instants of the motion in proportion to the light."""
    theta = (np.arange(20_000) + 0.5) / 20_000 * 2 * np.pi
    light = np.asarray(code)[(theta / (2 * np.pi) * len(code)).astype(int)]
    share = np.concatenate(([0.0], np.cumsum(light) / light.sum()))

    def path(t):
        angle = np.interp(t, share, np.linspace(0, 2 * np.pi, 20_001))
        ax, ay, bx, by = motion
        return ax * np.sin(angle) + bx * np.cos(angle), ay * np.sin(angle) + by * np.cos(angle)

    return area.render(scene, (size, size), (size / 2 + 0.1, size / 2), path, seed=seed, samples=600)


@pytest.mark.parametrize("phase", [0.3, 4.4])
def test_one_image_gives_the_signed_vectors(area, phase: float) -> None:
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)]
    )
    v = np.array([2.4, 1.8])
    truth = np.concatenate((v * np.cos(phase), v * np.sin(phase)))
    image = render_coded(area, scene, SEVEN, truth, 5, 61)
    window = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5))
    guess = [InitialGuess(np.array([30.0, 30.0]))]
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
    got = np.concatenate((found.a_px, found.b_px))
    sd = np.sqrt(np.diag(found.covariance_px2)[2:])
    assert found.phased
    assert not found.flags
    assert np.all(np.abs(got - truth) < 4.5 * sd + 0.01)
    lead = np.angle(np.vdot(truth[:2] + 1j * truth[2:], got[:2] + 1j * got[2:]))
    assert abs(np.degrees(lead)) < 2.0
    unknown = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5, is_phase_known=False))
    axes = measure_group(sharp, [image], [unknown], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
    assert not axes.phased
    assert np.hypot(*axes.a_px) == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("ratio", [0.012, -0.02])
def test_a_thin_orbit_is_within_its_deviations_though_its_minor_axis_does_not_show(area, ratio: float) -> None:
    """A damped structure's: taken for a straight path it was turned by up to ten of its standard deviations."""
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(36, 36, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (72, 72), (36.2, 35.7), seed=1)]
    )
    along, across, phase = np.array([7.8, 1.2]), np.array([-1.2, 7.8]), -0.5
    truth = np.concatenate(
        (
            along * np.cos(phase) - ratio * across * np.sin(phase),
            along * np.sin(phase) + ratio * across * np.cos(phase),
        )
    )
    window = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5))
    image = render_coded(area, scene, SEVEN, truth, 5, 81)
    guess = [InitialGuess(np.array([40.0, 40.0]))]
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
    assert not found.flags
    away = np.concatenate((found.a_px, found.b_px)) - truth
    assert away @ np.linalg.solve(found.covariance_px2[2:, 2:], away) < 14  # χ² of four


def test_a_symmetric_code_alone_is_ambiguous(area) -> None:
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)]
    )
    code = named_code("11010")
    image = render_coded(area, scene, code, (-1.5, -0.9, 2.1, 1.3), 5, 61)
    window = ExposureWindow(5.0, 1.0, light=LightCode(code, 0.0, 5))
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.01))
    assert Flag.AMBIGUOUS in found.flags


@pytest.mark.parametrize("seed", [3, 11])
def test_near_a_node_a_target_is_at_rest_and_costs_no_more_than_others(area, seed: int, monkeypatch) -> None:
    """There the phase does not show: steps went off without a bound, for minutes, or the covariance was negative."""
    counts: list[int] = []
    nodes = labdaemon.blur.waveform.gauss_legendre
    for module in (labdaemon.blur.waveform, labdaemon.blur.light_code):
        monkeypatch.setattr(module, "gauss_legendre", lambda count: (counts.append(count), nodes(count))[1])
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)]
    )
    rng = np.random.default_rng(seed)
    size, direction, phase = rng.uniform(0, 1.2), rng.uniform(0, 6.28), rng.uniform(0, 6.28)
    v = size * np.array([np.cos(direction), np.sin(direction)])
    n = np.array([-v[1], v[0]]) * rng.uniform(-0.1, 0.1)
    truth = np.concatenate((v * np.cos(phase) - n * np.sin(phase), v * np.sin(phase) + n * np.cos(phase)))
    image = render_coded(area, scene, SEVEN, truth, seed + 100, 61)
    window = ExposureWindow(5.0, 1.0, 0.7, light=LightCode(SEVEN, 0.0, 5, 0.05, 0.003, sd_ambient=0.005))
    guess = [InitialGuess(np.array([30.0, 30.0]))]
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
    assert found.flags == {Flag.AT_REST}
    assert np.all(np.linalg.eigvalsh(found.covariance_px2) > -1e-12)
    assert max(counts) < 500


def test_a_small_motion_is_within_its_deviations_on_the_shelf_of_its_valley(area) -> None:
    """Its cost is nearly level for 15°: by the curvature at the minimum alone, the truth was 6 deviations away."""
    scene = area.Scene(radius_px=12.0)
    sharp = fit_sharp(
        Dot(30, 30, 12, 12, 0.0, name="t", paper_px=200), [area.render(scene, (60, 60), (30.2, 29.7), seed=1)]
    )
    v, phase = 1.3 * np.array([0.8, 0.6]), np.radians(8.0)
    truth = np.concatenate((v * np.cos(phase), v * np.sin(phase)))
    image = render_coded(area, scene, SEVEN, truth, 6, 61)
    window = ExposureWindow(5.0, 1.0, light=LightCode(SEVEN, 0.0, 5))
    guess = [InitialGuess(np.array([30.0, 30.0]))]
    found = measure_group(sharp, [image], [window], defocus=Defocus(0.0, 0.01), initial_guesses=guess)
    assert not found.flags
    away = np.concatenate((found.a_px, found.b_px)) - truth
    assert away @ np.linalg.solve(found.covariance_px2[2:, 2:], away) < 14  # χ² of four
