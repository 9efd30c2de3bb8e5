"""Where a blurred target is, and how it moves, when the background of its label misleads every search for a dark dot.

Straight paths are tried over lengths and directions. Each is compared with the pixels that show nothing but label under
that very path, by the part of their variance that the modelled blur explains. The best ones are initial guesses.
One colour plane is enough for that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.label_settings import LABEL_EDGE
from labdaemon.blur.motion import InitialGuess
from labdaemon.blur.patch.colour_planes import ColourPlanes, make_grid, make_planes
from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.label_outline import LabelOutline
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights
from labdaemon.blur.smear.fast_forward_model import darkness_model
from labdaemon.blur.smear.fit_problem import FitProblem, rest_spectra
from labdaemon.blur.spectra import closed_form


def rank_trials(
    sharp: SharpTarget,
    outline: LabelOutline,
    patch: Patch,
    places_px: Sequence[FloatArray],
    guesses: Sequence[InitialGuess] = (),
) -> list[tuple[float, InitialGuess]]:
    """Straight paths that explain the pixels of the label best, the best first, each with the part that it explains.

    Parameters
    ----------
    sharp, outline, patch
        The target, its label, and its part of the blurred frame.
    places_px
        Mean positions to try, (2,) each.
    guesses
        Other paths to be ranked with them, by their major axes.
    """
    height, width = patch.shape
    patch = patch.crop(*patch.origin_px, width // 2 * 2, height // 2 * 2)  # colour planes of equal size
    problem = _prepare(sharp, patch)
    if problem is None:
        return []
    radius = max(sharp.form.half_size_px)
    count = LABEL_EDGE.trial_directions
    angles = np.pi * np.arange(count) / count
    paths = [np.zeros(2)] + [
        length * radius * np.array([np.cos(angle), np.sin(angle)])
        for length in LABEL_EDGE.trial_lengths
        for angle in angles
    ]
    score = _Score(sharp, outline, patch, problem)
    tried = [(np.asarray(place), a) for place in places_px for a in paths]
    tried += [(np.asarray(guess.centre_px), guess.a_px) for guess in guesses if guess.a_px is not None]
    first = sorted(((score(place, a), place, a) for place, a in tried), key=lambda one: -one[0])
    step = LABEL_EDGE.trial_offset * radius
    offsets = [step * np.array([x, y], dtype=np.float64) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    near = [
        (score(place + offset, a), place + offset, a)
        for _, place, a in first[: LABEL_EDGE.followed_trials]
        for offset in offsets
    ]
    near.sort(key=lambda one: -one[0])
    return [(value, InitialGuess(place, a, np.zeros(2))) for value, place, a in near[: LABEL_EDGE.followed_trials]]


def _prepare(sharp: SharpTarget, patch: Patch) -> FitProblem | None:
    if min(patch.shape) < 5 or not patch.valid.any():
        return None
    planes = make_planes(patch).first
    margin = sharp.form.psf_margin_px
    height, width = patch.shape
    grid = make_grid((height + margin, width + margin), sharp.form.oversampling)
    return FitProblem(planes, grid, rest_spectra(sharp.form, grid, planes).fixed_shape, sharp.centre_px, None)


class _Score:
    """The part of the variance of the clear pixels that a path explains; 0 where the ink is not the target's."""

    def __init__(self, sharp: SharpTarget, outline: LabelOutline, patch: Patch, problem: FitProblem) -> None:
        self._sharp, self._outline, self._patch, self._problem = sharp, outline, patch, problem
        self._model = darkness_model(problem, closed_form.straight_transfer)
        planes = problem.planes
        self._weight = pixel_weights(sharp, planes)(np.maximum(planes.values, 0.0))
        known = [sharp.contrast.get(int(channel), np.nan) for channel in planes.channel]
        self._contrast = np.array(known)

    def __call__(self, place: FloatArray, a: FloatArray) -> float:
        planes: ColourPlanes = self._problem.planes
        clear = self._outline.clear_pixels(self._patch, place, a, np.zeros(2), LABEL_EDGE.margin_px, step=planes.period)
        weight = np.where(clear, self._weight, 0.0)
        if planes.period**2 * np.count_nonzero(weight) < LABEL_EDGE.least_pixels:
            return 0.0
        dark = self._model(np.concatenate((place, [0.0], np.where(np.abs(a) < 0.1, 0.1, a))))
        light = solve_illumination(planes, weight, dark)
        ratio = float(np.nanmedian(light[:, 3] / self._contrast))
        if not abs(ratio - 1.0) < LABEL_EDGE.max_contrast_change:
            return 0.0
        left = float(np.sum(weight * (planes.values - render_illumination(planes, light, dark)) ** 2))
        mean = np.sum(weight * planes.values, axis=(1, 2)) / np.maximum(np.sum(weight, axis=(1, 2)), 1e-300)
        total = float(np.sum(weight * (planes.values - mean[:, None, None]) ** 2))
        return 1.0 - left / max(total, 1e-300)
