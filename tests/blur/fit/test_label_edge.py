"""Blurs that come near the end of their label: right without a flag, or `paper_edge`; never `occluded`."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from labdaemon.blur import Dot, InitialGuess, Patch, fit_sharp, measure
from labdaemon.blur.fit.label_trials import rank_trials
from labdaemon.blur.motion import Defocus
from labdaemon.blur.patch.label_outline import LabelOutline, path_points, without_background
from labdaemon.blur.phase.shared_waveform import estimate_waveform
from labdaemon.flags import Flag

STILL = Defocus(0.0, 0.01)
FINE = 3
RADIUS, PAPER, INK = 9.0, 2900.0, 230.0
SIZE, CENTRE = 96, np.array([47.3, 47.8])
NOTHING = np.zeros(2)


def outline(half_width: float, half_height: float, turn_rad: float = 0.0, rays: int = 72) -> tuple[float, ...]:
    angle = 2 * np.pi * np.arange(rays) / rays - turn_rad
    with np.errstate(divide="ignore"):
        ends = np.minimum(half_width / np.abs(np.cos(angle)), half_height / np.abs(np.sin(angle)))
    return tuple(float(one) for one in ends)


def frame(half, a, ground=1000.0, turn_rad=0.0, seed=1) -> Patch:
    """A dot on a rectangular label that moves with it, before a ground that stands still; pixel areas, whole cycles."""
    n = SIZE * FINE
    axis = (np.arange(n) + 0.5) / FINE - 0.5
    x, y = axis[None, :] - CENTRE[0], axis[:, None] - CENTRE[1]
    total = np.zeros((n, n))
    nodes = np.sin(np.pi * (2 * np.arange(48) + 1) / 96 - np.pi / 2)
    for node in nodes:
        u, v = x - node * a[0], y - node * a[1]
        p, q = u * np.cos(turn_rad) + v * np.sin(turn_rad), v * np.cos(turn_rad) - u * np.sin(turn_rad)
        label = (np.abs(p) < half[0]) & (np.abs(q) < half[1])
        total += np.where(np.hypot(u, v) < RADIUS, INK, np.where(label, PAPER, ground))
    light = ndimage.gaussian_filter(total / len(nodes), 0.75 * FINE).reshape(SIZE, FINE, SIZE, FINE).mean((1, 3))
    rng = np.random.default_rng(seed)
    values = light + rng.normal(size=light.shape) * np.sqrt(light / 8.5 + 0.64)
    return Patch(values, np.zeros(values.shape, np.uint8), np.ones(values.shape, bool), (0, 0))


def target(half, ground=1000.0, turn_rad=0.0):
    ends = outline(*half, turn_rad)
    dot = Dot(*CENTRE, RADIUS, RADIUS, 0.0, paper_px=min(ends), name="t", label_px=ends)
    return fit_sharp(dot, [frame(half, NOTHING, ground, turn_rad, seed=2)])


@pytest.mark.parametrize(
    ("half", "a", "ground", "turn_rad"),
    [
        ((18.0, 18.0), (7.0, 0.0), 800.0, 0.0),
        ((18.0, 18.0), (4.0, -5.0), 2500.0, 0.0),
        ((16.0, 30.0), (0.5, 11.0), 3300.0, 0.0),
        ((18.0, 18.0), (6.0, 3.0), 1500.0, 0.5),
    ],
)
def test_what_the_label_leaves_suffices(half, a, ground, turn_rad):
    guess = InitialGuess(CENTRE, np.round(np.asarray(a)), NOTHING)
    found = measure(
        target(half, ground, turn_rad), frame(half, a, ground, turn_rad), defocus=STILL, initial_guess=guess
    )
    assert found.flags == frozenset()
    # The rendering itself (thirds of a pixel) is good to 0.03 px.
    assert found.amplitude_px == pytest.approx(np.hypot(*a), abs=3 * found.sd_px + 0.04)


@pytest.mark.parametrize("guess", [None, InitialGuess(CENTRE, np.array([4.0, 5.0]), NOTHING)])
def test_a_wrong_guess_does_not_matter(guess):
    half, a = (18.0, 18.0), (7.0, 2.0)
    found = measure(target(half), frame(half, a), defocus=STILL, initial_guess=guess)
    assert Flag.OCCLUDED not in found.flags
    assert Flag.PAPER_EDGE in found.flags or abs(found.amplitude_px - np.hypot(*a)) < 3 * found.sd_px + 0.04


def test_a_path_as_long_as_the_label_is_flagged():
    half, a = (14.0, 14.0), (17.0, 0.0)
    guess = InitialGuess(CENTRE, np.asarray(a), NOTHING)
    found = measure(target(half), frame(half, a), defocus=STILL, initial_guess=guess)
    assert Flag.PAPER_EDGE in found.flags
    assert Flag.OCCLUDED not in found.flags


@pytest.mark.parametrize(("half", "a"), [(12.0, (11.0, 4.0)), (15.6, (-11.0, 2.6))])
def test_a_ground_that_stays_in_the_fit_is_flagged(half, a):
    """Without a guess the first mask is that of rest; that of the path found leaves no pixel to confirm it with."""
    ground = 3092.0
    found = measure(target((half, half), ground), frame((half, half), a, ground), defocus=STILL)
    assert Flag.PAPER_EDGE in found.flags or abs(found.amplitude_px - np.hypot(*a)) < 3 * found.sd_px + 0.04


def test_paper_all_around_is_left_alone():
    patch = frame((30.0, 30.0), (3.0, 0.0))
    ends = LabelOutline((90.0,) * 72)
    assert without_background(ends, patch, CENTRE, np.array([3.0, 0.0]), NOTHING, 2.5) is patch
    assert ends.holds(RADIUS, np.array([3.0, 0.0]), NOTHING)


def test_clear_pixels_are_those_of_the_label_at_every_instant():
    half, a = (16.0, 22.0), np.array([5.0, -2.0])
    clear = LabelOutline(outline(*half)).clear_pixels(frame(half, a), CENTRE, a, NOTHING, 2.0)
    x, y = np.arange(SIZE) - CENTRE[0], (np.arange(SIZE) - CENTRE[1])[:, None]
    inside = (np.abs(x) < half[0] - 2 - abs(a[0])) & (np.abs(y) < half[1] - 2 - abs(a[1]))
    assert not (clear & ~(np.abs(x) < half[0] - abs(a[0]) - 1)).any()
    assert np.mean(clear[inside]) > 0.97


@pytest.mark.parametrize(("a", "b"), [((3.0, 1.0), (0.0, 0.0)), ((3.0, 1.0), (-0.5, 1.5))])
def test_path_points_reach_the_ends_of_both_axes(a, b):
    points = path_points(np.asarray(a), np.asarray(b))
    for end in (a, [-v for v in a], b):
        assert np.min(np.hypot(*(points - end).T)) < 1e-9


def test_hidden_pixels_of_the_ground_are_no_white_level():
    """Bright ground beyond the mask must not count as the ceiling of the sensor."""
    half, a = (18.0, 18.0), (6.0, 0.0)
    guess = InitialGuess(CENTRE, np.asarray(a), NOTHING)
    found = measure(target(half, PAPER + 50), frame(half, a, PAPER + 50), defocus=STILL, initial_guess=guess)
    assert found.amplitude_px == pytest.approx(6.0, abs=0.05)
    assert Flag.SATURATED not in found.flags


def test_trials_take_a_mosaic_of_odd_size():
    half, a = (18.0, 18.0), (7.0, 2.0)
    grey = frame(half, a)
    channel = np.tile(np.array([[0, 1], [2, 3]], np.uint8), (SIZE // 2, SIZE // 2))
    sharp_grey = frame(half, NOTHING, seed=2)
    ends = outline(*half)
    dot = Dot(*CENTRE, RADIUS, RADIUS, 0.0, paper_px=min(ends), name="t", label_px=ends)
    sharp = fit_sharp(dot, [Patch(sharp_grey.values, channel, sharp_grey.valid, (0, 0))])
    odd = Patch(grey.values, channel, grey.valid, (0, 0)).crop(1, 0, 95, 93)
    (value, best), *_ = rank_trials(sharp, LabelOutline(ends), odd, [CENTRE])
    assert value > 0.8
    assert np.hypot(*best.a_px) == pytest.approx(7.3, abs=2.0)


def test_the_ground_of_a_label_is_no_other_waveform():
    """All targets would be fitted with the third harmonic that the background of some seems to show."""
    half, ground, a = (13.0, 13.0), 2600.0, (0.0, 7.0)
    sharp, patch = target(half, ground), frame(half, a, ground)
    guess = InitialGuess(CENTRE, np.asarray(a), NOTHING)
    found = measure(sharp, patch, defocus=STILL, initial_guess=guess)
    shared = estimate_waveform([sharp] * 6, [patch] * 6, [found] * 6, defocus=STILL, whole=True)
    assert not found.flags
    assert shared.harmonic is None
    blind = estimate_waveform([replace(sharp, outline=None)] * 6, [patch] * 6, [found] * 6, defocus=STILL, whole=True)
    assert blind.harmonic is not None, "the scene does not show what it is for"
