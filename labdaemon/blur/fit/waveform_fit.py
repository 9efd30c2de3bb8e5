"""Motion by a declared law instead of a sinusoid."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.motion import Defocus, Measurement
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.initial_parameters import initial_parameters
from labdaemon.blur.smear.uncertainty import quality_flags, robust_covariance
from labdaemon.blur.solver.solve import solve
from labdaemon.blur.waveform import MotionWaveform, quadrature_transfer
from labdaemon.flags import Flag
from labdaemon.orbit_axes import moment_matrix, orient_positive


def measure_waveform(sharp: SharpTarget, problem: FitProblem, blur: Defocus, waveform: MotionWaveform) -> Measurement:
    """Fit the vector that multiplies a declared course; both of its signs are tried."""
    k = problem.shape_count

    def motion(fx: FloatArray, fy: FloatArray, vector: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return quadrature_transfer(fx, fy, vector, waveform.displacement[None], waveform.weight)

    spread = float(waveform.weight @ waveform.displacement**2)
    model, weights = fast_forward_model(problem, motion), pixel_weights(sharp, problem.planes)
    prior = nuisance_prior(sharp, blur, 2)
    solutions = []
    for start in initial_parameters(sharp, problem, blur, k):
        values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
        vector = vectors[:, 1] * np.sqrt(max(values[1], 0.02) * 0.5 / spread)
        for sign in (1.0, -1.0):
            solutions.append(
                solve(problem.planes, weights, model, np.concatenate((start[: 3 + k], sign * vector)), prior)
            )
    best = min(solutions, key=lambda x: x.cost)
    if not sharp.noise_known:
        weights = pixel_weights(sharp, problem.planes, noise_scale(sharp, best))
        best = solve(problem.planes, weights, model, best.p, prior, light=best.light)
    mirrored = min((x.cost for x in solutions if float(x.p[-2:] @ best.p[-2:]) < 0), default=np.inf)
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = robust_covariance(sharp, best, problem.planes)[np.ix_(pick, pick)]
    signed = mirrored - best.cost > 9.0 * max(best.chi2, 1.0)
    a = best.p[-2:].copy()
    if not signed and not np.array_equal(orient_positive(a), a):
        a = -a
        covariance[:2, 2:4] *= -1
        covariance[2:4, :2] *= -1
    flags = quality_flags(sharp, best, a, np.zeros(2))
    sd = float(np.sqrt(a @ covariance[2:4, 2:4] @ a)) / max(float(np.hypot(*a)), 1e-12)
    if float(np.hypot(*a)) < UNCERTAINTY.rest_sds * sd:
        flags.add(Flag.AT_REST)
    return Measurement(
        sharp.name, best.p[:2].copy(), a, np.zeros(2), covariance, signed, frozenset(flags), float(best.p[2]), best.chi2
    )
