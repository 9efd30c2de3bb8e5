"""Motion by a declared law instead of a sinusoid."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.axes import moment_matrix, positive
from labdaemon.blur.law import DisplacementLaw, nodes_transfer
from labdaemon.blur.motion import ExtraBlur, Measurement
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import noise_scale, nuisance_prior, pixel_weights
from labdaemon.blur.smear.honesty import REST_SIGMAS, honest_covariance, reach_flags
from labdaemon.blur.smear.model import Setting, blurred_model
from labdaemon.blur.smear.starts import starts_of
from labdaemon.blur.solver.solve import solve
from labdaemon.flags import Flag


def measure_declared(sharp: SharpTarget, setting: Setting, blur: ExtraBlur, law: DisplacementLaw) -> Measurement:
    """Fit the vector that multiplies a declared course; both of its signs are tried."""
    k = setting.shapes

    def motion(fx: FloatArray, fy: FloatArray, vector: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return nodes_transfer(fx, fy, vector, law.displacement[None], law.weight)

    spread = float(law.weight @ law.displacement**2)
    model, weights = blurred_model(setting, motion), pixel_weights(sharp, setting.planes)
    prior = nuisance_prior(sharp, blur, 2)
    solutions = []
    for start in starts_of(sharp, setting, blur, k):
        values, vectors = np.linalg.eigh(moment_matrix(start[3 + k :]))
        vector = vectors[:, 1] * np.sqrt(max(values[1], 0.02) * 0.5 / spread)
        for sign in (1.0, -1.0):
            solutions.append(
                solve(setting.planes, weights, model, np.concatenate((start[: 3 + k], sign * vector)), prior)
            )
    best = min(solutions, key=lambda x: x.cost)
    if not sharp.noise_known:
        weights = pixel_weights(sharp, setting.planes, noise_scale(sharp, best))
        best = solve(setting.planes, weights, model, best.p, prior, light=best.light)
    mirrored = min((x.cost for x in solutions if float(x.p[-2:] @ best.p[-2:]) < 0), default=np.inf)
    pick = [0, 1, 3 + k, 4 + k]
    covariance = np.zeros((6, 6))
    covariance[:4, :4] = honest_covariance(sharp, best, setting.planes)[np.ix_(pick, pick)]
    signed = mirrored - best.cost > 9.0 * max(best.chi2, 1.0)
    a = best.p[-2:].copy()
    if not signed and not np.array_equal(positive(a), a):
        a = -a
        covariance[:2, 2:4] *= -1
        covariance[2:4, :2] *= -1
    flags = reach_flags(sharp, best, a, np.zeros(2))
    sd = float(np.sqrt(a @ covariance[2:4, 2:4] @ a)) / max(float(np.hypot(*a)), 1e-12)
    if float(np.hypot(*a)) < REST_SIGMAS * sd:
        flags.add(Flag.AT_REST)
    return Measurement(
        sharp.name, best.p[:2].copy(), a, np.zeros(2), covariance, signed, frozenset(flags), float(best.p[2]), best.chi2
    )
