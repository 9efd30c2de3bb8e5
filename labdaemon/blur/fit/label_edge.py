"""Blurs that come near the end of their label: fitted where there is nothing but label at every instant of the path.

What may be used depends on the motion, and the motion is what is measured. So the fit is repeated with the mask of its
own result until that no longer changes. If what is left determines the motion, the measurement is one like any other.
Otherwise it is flagged `paper_edge` where the blur reaches the smeared end of the label.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.fit.label_trials import rank_trials
from labdaemon.blur.label_settings import LABEL_EDGE
from labdaemon.blur.motion import InitialGuess, Measurement
from labdaemon.blur.patch.label_outline import LabelOutline, without_background
from labdaemon.blur.patch.pixels import FloatArray, Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.smear.fit_problem import FitProblem, prepare_fit
from labdaemon.flags import Flag

Attempt = Callable[[Patch, InitialGuess, bool], Measurement]
"""Measures a masked patch from an initial guess; the last argument says whether an occluder is searched."""


def reaches_patch(outline: LabelOutline, patch: Patch, guess: InitialGuess) -> bool:
    """Whether the background may enter any pixel of the patch."""
    a, b = _axes(guess)
    return not bool(outline.clear_pixels(patch, guess.centre_px, a, b, LABEL_EDGE.margin_px).all())


def prepare_on_label(
    sharp: SharpTarget, patch: Patch, guess: InitialGuess, *, is_divided: bool = False
) -> FitProblem | None:
    """Prepare a fit as `prepare_fit` does; without background where the guessed path brings it into the blur.

    Parameters
    ----------
    is_divided
        Whether the blur may consist of several blobs along the guessed path.
    """
    path_px = _axes(guess)[0] if is_divided and np.any(_axes(guess)) else None
    expected = np.asarray(guess.centre_px, dtype=np.float64)
    radius = max(sharp.form.half_size_px) + LABEL_EDGE.holding_margin_px
    if sharp.outline is None or not np.any(_axes(guess)) or sharp.outline.holds(radius, *_axes(guess)):
        return prepare_fit(sharp, patch, expected, path_px=path_px)
    problem = prepare_fit(sharp, _masked(sharp.outline, patch, guess), expected, path_px=path_px)
    return None if problem is None else problem.starting_from(sharp, guess)


def measure_on_label(
    sharp: SharpTarget, outline: LabelOutline, patch: Patch, guess: InitialGuess, attempt: Attempt
) -> Measurement:
    """Measure a target whose label ends within the patch.

    Parameters
    ----------
    sharp, outline, patch
        The target, its label, and its part of the blurred frame.
    guess
        Where it is and how it moves, roughly.
    attempt
        The fit.
    """
    guesses = [
        replace(guess, a_px=scale * _axes(guess)[0], b_px=scale * _axes(guess)[1]) for scale in LABEL_EDGE.first_scales
    ]
    if not np.any(_axes(guess)):
        guesses = guesses[:1]
    found = _first_determined(sharp, outline, patch, guesses[:1], attempt)
    trials: list[tuple[float, InitialGuess]] | None = None
    if _is_hopeless(found, sharp):
        # A target that is hidden costs least where it is seen first that no path explains anything.
        trials = rank_trials(sharp, outline, patch, [np.asarray(guess.centre_px, dtype=np.float64)], guesses)
    if trials is None or (trials and trials[0][0] >= LABEL_EDGE.least_explained):
        found = _better(found, _first_determined(sharp, outline, patch, guesses[1:], attempt), sharp)
    if found is not None and is_determined(found, sharp):
        return found
    radius = max(sharp.form.half_size_px)
    longest = max(_size(_axes(guess)[0]), 0.0 if found is None else _size(found.a_px), LABEL_EDGE.least_length * radius)
    if outline.nearest_px > radius + 2.0 * longest + LABEL_EDGE.holding_margin_px:
        return attempt(patch, _place(guess), True)  # no such path brings the end of the label near
    if trials is None:
        trials = rank_trials(sharp, outline, patch, [np.asarray(guess.centre_px, dtype=np.float64)])
    explained = trials[0][0] if trials else 0.0
    # Where no path explains what is seen, fits from those paths cannot either.
    followed = [trial for value, trial in trials if value >= LABEL_EDGE.least_explained]
    better = _first_determined(sharp, outline, patch, followed, attempt)
    if better is not None and is_determined(better, sharp):
        return better
    seen = [guess] if explained < LABEL_EDGE.least_explained else [guess, trials[0][1]]
    if all(outline.holds(radius + LABEL_EDGE.holding_margin_px, *_axes(one)) for one in seen):
        return _on_own_label(
            sharp, outline, patch, attempt(_masked(outline, patch, guess), _place(guess), True), attempt
        )
    clear = outline.clear_pixels(patch, np.asarray(guess.centre_px), *_axes(guess), LABEL_EDGE.margin_px)
    if explained < LABEL_EDGE.least_explained and np.count_nonzero(clear) >= LABEL_EDGE.least_pixels:
        # Something other than the edge of the label: an occluder, or the target is not there.
        other = attempt(_masked(outline, patch, guess), _place(guess), True)
        if found is not None and Flag.OCCLUDED not in other.flags:
            return _at_edge(found)
        return _on_own_label(sharp, outline, patch, other, attempt)
    last = better if better is not None else found
    return _at_edge(last) if last is not None else _lost(sharp)


def _on_own_label(
    sharp: SharpTarget, outline: LabelOutline, patch: Patch, found: Measurement, attempt: Attempt
) -> Measurement:
    """A fit under the mask of another path, a guess's or rest, checked under that of its own.

    Without a guess nothing says that the path is longer than the label is wide; the ground is then a part of the fit.
    """
    if found.flags & {Flag.OCCLUDED, Flag.POOR_FIT} or not np.isfinite([*found.a_px, *found.b_px]).all():
        return found
    again = _first_determined(sharp, outline, patch, [_as_guess(found)], attempt)
    if again is not None and is_determined(again, sharp):
        return again
    radius = max(sharp.form.half_size_px) + LABEL_EDGE.holding_margin_px
    return found if outline.holds(radius, found.a_px, found.b_px) else _at_edge(found)


def _is_hopeless(found: Measurement | None, sharp: SharpTarget) -> bool:
    """Whether a first fit is so bad that the target may not be there at all."""
    return found is not None and not is_determined(found, sharp) and found.chi2 > LABEL_EDGE.hopeless_chi2


def _better(one: Measurement | None, other: Measurement | None, sharp: SharpTarget) -> Measurement | None:
    """The one that determines the motion, else the one that fits best."""
    if one is None or other is None:
        return one if other is None else other
    if is_determined(one, sharp) != is_determined(other, sharp):
        return one if is_determined(one, sharp) else other
    return one if one.chi2 <= other.chi2 else other


def _at_edge(found: Measurement) -> Measurement:
    return replace(found, flags=(found.flags - {Flag.OCCLUDED}) | {Flag.PAPER_EDGE})


def _first_determined(
    sharp: SharpTarget, outline: LabelOutline, patch: Patch, guesses: Sequence[InitialGuess], attempt: Attempt
) -> Measurement | None:
    """The first fit that determines the motion; or the one that fits best, or None."""
    best: Measurement | None = None
    for guess in guesses:
        one, is_masked = _iterate(outline, patch, guess, attempt)
        if one is not None and is_masked and is_determined(one, sharp):
            return replace(one, flags=one.flags - {Flag.PAPER_EDGE})
        if one is not None and (best is None or one.chi2 < best.chi2):
            best = one
    return best


def is_determined(found: Measurement, sharp: SharpTarget) -> bool:
    """Whether a measurement has numbers, fits as well as the sharp frame, and its amplitude is known well enough."""
    if not np.isfinite(found.a_px).all() or not np.isfinite(found.covariance_px2).all():
        return False
    if (found.flags - sharp.flags) & {Flag.POOR_FIT, Flag.OCCLUDED, Flag.NOT_FOUND}:
        return False
    limit = max(LABEL_EDGE.max_sd_px, LABEL_EDGE.max_sd_fraction * found.amplitude_px)
    return Flag.AT_REST in found.flags or found.sd_px <= limit


def _iterate(
    outline: LabelOutline, patch: Patch, guess: InitialGuess, attempt: Attempt
) -> tuple[Measurement | None, bool]:
    """The fit under the mask of its own result; the last one with numbers, or None.

    Returns
    -------
    found, is_masked
        The fit, and whether its mask was that of a path at least as long as the result. A path as long as its label is
        wide leaves no pixel under its own mask, and a shorter one's leaves the ground in the fit.
    """
    last: Measurement | None = None
    is_masked = False
    for _ in range(LABEL_EDGE.iterations):
        found = attempt(_masked(outline, patch, guess), guess, False)
        if not np.isfinite([*found.centre_px, *found.a_px, *found.b_px]).all():
            break
        is_masked = _size(found.a_px) < _size(_axes(guess)[0]) + LABEL_EDGE.settled_px
        settled = last is not None and _size(found.a_px - _axes(guess)[0]) < LABEL_EDGE.settled_px
        # The mask of a path that fits badly can mend it once; where it does not, there is no such path.
        settled |= last is not None and found.chi2 > max(LABEL_EDGE.hopeless_chi2, last.chi2 / 2)
        last, guess = found, _as_guess(found)
        if settled:
            break
    return last, is_masked


def _masked(outline: LabelOutline, patch: Patch, guess: InitialGuess) -> Patch:
    return without_background(outline, patch, guess.centre_px, *_axes(guess), LABEL_EDGE.margin_px)


def _axes(guess: InitialGuess) -> tuple[FloatArray, FloatArray]:
    zero = np.zeros(2)
    return (guess.a_px if guess.a_px is not None else zero), (guess.b_px if guess.b_px is not None else zero)


def _place(guess: InitialGuess) -> InitialGuess:
    """The place alone: a fit then begins from the moments of what is seen."""
    return InitialGuess(guess.centre_px)


def _as_guess(found: Measurement) -> InitialGuess:
    return InitialGuess(found.centre_px, found.a_px, found.b_px)


def _size(vector: FloatArray) -> float:
    return float(np.hypot(*vector))


def _lost(sharp: SharpTarget) -> Measurement:
    nan = np.full(2, np.nan)
    flags = frozenset({Flag.PAPER_EDGE, Flag.NOT_FOUND})
    return Measurement(sharp.name, nan, nan, nan, np.full((6, 6), np.nan), flags=flags, chi2=float("nan"))
