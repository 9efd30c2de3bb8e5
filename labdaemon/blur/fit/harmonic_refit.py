"""A motion over whole cycles fitted once more, with the harmonics that a gauge shows.

The fit of a pure sinusoid is the start: it settled which path it is, what is masked, and whether anything moves. Its
closed forms have no place for harmonics, so that the second fit sums over nodes in time. A minor axis keeps its phase
at a quarter of a cycle: over whole cycles the phase of an orbit does not show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.motion import Defocus, ExposureWindow, Measurement
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.sharp.weights import noise_scale, pixel_weights
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.smear.frame_set import FrameSet, TransferFactory, window_fixed_phase_transfer
from labdaemon.blur.smear.gls import gls_refine
from labdaemon.blur.smear.uncertainty import quality_flags, straight_path_covariance, windowed_covariance
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import quadrature_transfer
from labdaemon.flags import Flag
from labdaemon.orbit_axes import principal_axes, second_moment

MIN_SCALE = 0.5
"""A fit with harmonics that changes the amplitude by more than this has found something else."""


def refit_with_harmonics(
    sharp: SharpTarget, problem: FitProblem, blur: Defocus, found: Measurement, harmonics: MotionHarmonics
) -> Measurement:
    """Fit the motion with its harmonics, from the fit without them.

    Parameters
    ----------
    sharp, problem, blur
        As they were measured.
    found
        The pure sinusoid. What is at rest, or was not measured, stays as it is.
    harmonics
        Of the motion; their standard deviations enter the covariance.
    """
    if not np.isfinite([*found.a_px, *found.b_px]).all() or Flag.AT_REST in found.flags:
        return found
    frame_set = _frame_set(sharp, problem, blur, harmonics)
    if isinstance(sharp.form, TexturedPatch):
        return _scale(found, frame_set)
    best, factory = _fit_path(frame_set, found)
    first, k = frame_set.first_motion, frame_set.shape_count
    is_orbit = len(best.p) > first + 2
    axes = _axes(best.p[first:])
    model = frame_set.forward_model(factory, _reach_px(best.p[first:]), exact=True)
    prior = frame_set.prior(len(best.p) - first)
    refined = gls_refine(sharp, problem, best, model, second_moment(axes[:2], axes[2:]), prior)
    covariance = windowed_covariance(refined, frame_set, factory)
    if is_orbit:
        axes = _axes(refined.p[first:])
        turn = np.zeros((6, len(refined.p)))
        turn[[0, 1], [0, 1]] = 1.0
        turn[2:, first:] = _axes_jacobian(refined.p[first:])
        a, b, covariance = principal_axes(axes[:2], axes[2:], turn @ covariance @ turn.T)
    else:
        sd_minor = float(np.sqrt(max(np.trace(found.covariance_px2[4:, 4:]), 0.0)))
        a, b, covariance = straight_path_covariance(refined.p, covariance, k, sd_minor)
    # Flags of the sinusoid's own residuals give way to those of this fit.
    flags = (found.flags - {Flag.POOR_FIT, Flag.PAPER_EDGE}) | quality_flags(sharp, refined, a, b)
    return replace(
        found,
        centre_px=refined.p[:2].copy(),
        a_px=a,
        b_px=b,
        covariance_px2=covariance,
        flags=frozenset(flags),
        defocus_px2=float(refined.p[2]),
        chi2=refined.chi2,
    )


def _frame_set(sharp: SharpTarget, problem: FitProblem, blur: Defocus, harmonics: MotionHarmonics) -> FrameSet:
    """One frame over one whole cycle, of which the blur is the same as of many."""
    window = ExposureWindow(1.0, 1.0, 0.0, harmonics=harmonics.at_phase(0.0))
    return FrameSet.from_problems(sharp, [problem], [window], [blur])


def _fit_path(frame_set: FrameSet, found: Measurement) -> tuple[Solution, TransferFactory]:
    """A straight path, or an orbit whose minor axis shows with harmonics too, which look like one."""
    straight = window_fixed_phase_transfer(0.0)
    best = _solve(frame_set, found, straight, found.a_px)
    if not found.b_px.any():
        return best, straight
    minor = float(np.hypot(*found.b_px))
    a = best.p[frame_set.first_motion :]
    orbit = _solve(frame_set, found, _axes_transfer, np.append(a, minor))
    shows = best.cost - orbit.cost > UNCERTAINTY.rest_sds**2 * max(orbit.chi2, 1.0)
    return (orbit, _axes_transfer) if shows else (best, straight)


def _solve(frame_set: FrameSet, found: Measurement, factory: TransferFactory, motion: FloatArray) -> Solution:
    """The best fit of a path and, where even harmonics tell them apart, of the same path run the other way."""
    harmonics = frame_set.windows[0].harmonics
    signs = (1.0, -1.0) if harmonics is not None and harmonics.has_even else (1.0,)
    model = frame_set.forward_model(factory, _reach_px(motion))
    sharp, planes, prior = frame_set.sharp, frame_set.planes, frame_set.prior(len(motion))
    nuisance = np.concatenate((found.centre_px, [found.defocus_px2], np.zeros(frame_set.shape_count)))
    starts = [np.concatenate((nuisance, sign * motion)) for sign in signs]
    best = min((solve(planes, frame_set.weights, model, start, prior) for start in starts), key=lambda one: one.cost)
    if not sharp.noise_known:
        weights = pixel_weights(sharp, planes, noise_scale(sharp, best))
        best = solve(planes, weights, model, best.p, prior, light=best.light)
    return best


def _reach_px(motion: FloatArray) -> float:
    return 3.0 + 1.3 * float(np.linalg.norm(motion))


def _axes(motion: FloatArray) -> FloatArray:
    """(4,) ax, ay, bx, by of a motion by ax, ay and, of an orbit, the length of its minor axis."""
    if len(motion) == 2:
        return np.concatenate((motion, np.zeros(2)))
    a, size = motion[:2], max(float(np.hypot(*motion[:2])), 1e-9)
    return np.concatenate((a, motion[2] * np.array((-a[1], a[0])) / size))


def _axes_jacobian(motion: FloatArray) -> FloatArray:
    """(4, 3) derivative of `_axes` for an orbit."""
    size = max(float(np.hypot(*motion[:2])), 1e-9)
    along = motion[:2] / size
    across = np.array((-along[1], along[0]))
    # The minor axis turns with the major one: d across = −along · (across · da) / size.
    return np.block(
        [
            [np.eye(2), np.zeros((2, 1))],
            [-motion[2] / size * np.outer(along, across), across[:, None]],
        ]
    )


def _axes_transfer(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    """An orbit by its major axis (ax, ay) and the length of its minor one, a quarter of a cycle later."""

    def motion(fx: FloatArray, fy: FloatArray, parameters: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        transfer, by_axes = quadrature_transfer(fx, fy, _axes(parameters), basis, weight)
        return transfer, np.einsum("ij,ihw->jhw", _axes_jacobian(parameters), by_axes)

    return motion


def _scale(found: Measurement, frame_set: FrameSet) -> Measurement:
    """A textured patch's motion, scaled by what the harmonics change in a plain fit of it.

    Its own fit corrects for the noise of the template, which has no form for harmonics.
    """
    pure = replace(frame_set, windows=[replace(window, harmonics=None) for window in frame_set.windows])
    factory = window_fixed_phase_transfer(0.0)
    sizes = [
        float(np.hypot(*_solve(one, found, factory, found.a_px).p[one.first_motion :])) for one in (frame_set, pure)
    ]
    factor = sizes[0] / max(sizes[1], 1e-9)
    if not MIN_SCALE < factor < 1.0 / MIN_SCALE:
        return found
    turn = np.diag([1.0, 1.0, *[factor] * 4])
    covariance = turn @ found.covariance_px2 @ turn
    return replace(found, a_px=factor * found.a_px, b_px=factor * found.b_px, covariance_px2=covariance)
