"""What one target's image says of the waveform: equations of the series' coefficients at its whole-cycle solution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.label_settings import LABEL_EDGE
from labdaemon.blur.motion import Defocus, ExposureWindow, InitialGuess, Measurement
from labdaemon.blur.patch.label_outline import without_background
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray, Patch
from labdaemon.blur.phase.waveform_series import ORDERS, series_transfer
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.defocus import default_defocus
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import TransferFunction, prepare_fit
from labdaemon.blur.smear.frame_set import FrameSet
from labdaemon.blur.smear.gls_frames import frame_products
from labdaemon.blur.solver.reduced_equations import Prior, Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.unsolvable import solved
from labdaemon.flags import Flag
from labdaemon.least_squares import scaled_inverse

TARGETS = 6
"""Targets that are asked where the first ones show something; more cost time, and hardly say more."""
FIRST_TARGETS = 2
"""Targets that are asked of every frame: they hold most of the evidence, and one takes as long as two are measured."""
SIGN = 12.0
"""Squared standard deviations, beyond the expectation, by which any waveform must explain a target better for others to
be asked. Statistics: noise reaches it in one target of a hundred."""
BEST_PX = 7.0
"""Semi-amplitude that says most for its cost: shorter paths are blurred by the lens, longer ones by the paper."""
LEAST_PX, LARGEST_PX = 1.0, 16.0
"""Semi-amplitudes that are asked."""
STRAIGHT = 0.2
"""Minor over major axis up to which a path may be straight: a harmonic or a part cycle looks like a small one."""
NO_EVIDENCE = frozenset({Flag.AT_REST, Flag.SATURATED, Flag.PAPER_EDGE, Flag.NOT_FOUND, Flag.MIXED_MOTION})


@dataclass(frozen=True, slots=True, eq=False)
class WaveformEvidence:
    """What one target's image says of the exposure and the waveform.

    Attributes
    ----------
    frame_set, solution
        The target and its straight path over whole cycles.
    information, score
        (ORDERS + 1, ORDERS + 1) and (ORDERS + 1,) equations of the series' coefficients, everything else eliminated.
    by_series
        (2, ORDERS + 1) change of the path's vector by the coefficients, px.
    flags
        Of the target's measurement as over whole cycles.
    """

    frame_set: FrameSet
    solution: Solution
    information: FloatArray
    score: FloatArray
    by_series: FloatArray
    flags: frozenset[Flag] = frozenset()

    @property
    def amplitude_px(self) -> float:
        """Semi-amplitude as over whole cycles."""
        return float(np.hypot(*self.solution.p[-2:]))

    def gain(self, terms: Sequence[int]) -> float:
        """By how many squared standard deviations these coefficients, all free, explain the image better."""
        information, score = self.information[np.ix_(terms, terms)], self.score[terms]
        return float(score @ scaled_inverse(information) @ score) / self.scale

    @property
    def scale(self) -> float:
        """Residuals over the noise model, at least 1."""
        return max(self.solution.chi2, 1.0)


@solved
def waveform_evidence(
    sharp: SharpTarget, patch: Patch, found: Measurement, defocus: Defocus | None
) -> WaveformEvidence | None:
    """What a target's image says of the exposure; None where it cannot be looked at.

    Parameters
    ----------
    sharp, patch
        The target, and its part of the frame.
    found
        Its motion as over whole cycles, roughly; what is curved says nothing here.
    defocus
        Of the frame.
    """
    if not sharp.usable or not sharp.noise_known or isinstance(sharp.form, TexturedPatch):
        return None
    if sharp.outline is not None:
        # Background that the label's end brings into the blur looks like another waveform.
        patch = without_background(sharp.outline, patch, found.centre_px, found.a_px, found.b_px, LABEL_EDGE.margin_px)
    problem = prepare_fit(sharp, patch, found.centre_px)
    if problem is None:
        return None
    problem = problem.starting_from(sharp, InitialGuess(found.centre_px, found.a_px, np.zeros(2)))
    blur = defocus if defocus is not None else default_defocus(sharp)
    there = sharp.with_scale_uncertainty(problem.initial_centre_px)
    frame_set = FrameSet.from_problems(there, [problem], [ExposureWindow(1.0, 1.0, 0.0)], [blur])
    start = np.concatenate((found.centre_px, [found.defocus_px2], np.zeros(frame_set.shape_count), found.a_px))
    model, prior = fast_forward_model(problem, closed_form.straight_transfer), frame_set.prior(2)
    solution = solve(frame_set.planes, frame_set.weights, model, start, prior)
    return WaveformEvidence(frame_set, solution, *_series_equations(frame_set, solution, prior), found.flags)


def _series_equations(
    frame_set: FrameSet, solution: Solution, prior: Prior
) -> tuple[FloatArray, FloatArray, FloatArray]:
    extended = replace(solution, p=np.concatenate((solution.p, np.zeros(ORDERS + 2))))
    ((_, products, _),) = frame_products(frame_set, extended, _series_factory)
    normal, score = products[:-1, :-1].copy(), products[:-1, -1].copy()
    k = len(solution.p)
    normal[:k, :k] += prior.precision
    score[:k] -= prior.precision @ (solution.p - prior.mean)
    k += 1  # the minor axis
    inverse = scaled_inverse(normal[:k, :k])
    cross = normal[k:, :k] @ inverse
    return normal[k:, k:] - cross @ normal[:k, k:], score[k:] - cross @ score[:k], -cross.T[-3:-1]


def _series_factory(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return series_transfer(fx, fy, p)

    return motion


def collect_evidence(
    sharps: Sequence[SharpTarget], patches: Sequence[Patch], measured: Sequence[Measurement], defocus: Defocus | None
) -> list[WaveformEvidence]:
    """What the targets with long straight paths say; parameters as for `estimate_window`."""
    chosen = [index for index, one in enumerate(measured) if _says_something(one)]
    chosen.sort(key=lambda index: abs(math.log(measured[index].amplitude_px / BEST_PX)))
    found: list[WaveformEvidence] = []
    for place, index in enumerate(chosen[:TARGETS]):
        if place == FIRST_TARGETS and not any(_shows_waveform(one) for one in found):
            break
        one = waveform_evidence(sharps[index], patches[index], measured[index], defocus)
        if one is not None:
            found.append(one)
    return found


def _shows_waveform(one: WaveformEvidence) -> bool:
    """Whether any exposure or harmonic explains a target better than noise does: all coefficients free."""
    count = len(one.score)
    return one.gain(range(count)) > count + SIGN


def _says_something(one: Measurement) -> bool:
    """Whether a target has a straight path long enough to show the waveform."""
    if not np.isfinite([*one.a_px, *one.b_px]).all() or one.flags & NO_EVIDENCE:
        return False
    straight = float(np.hypot(*one.b_px)) < STRAIGHT * float(np.hypot(*one.a_px))
    return straight and LEAST_PX < one.amplitude_px < LARGEST_PX
