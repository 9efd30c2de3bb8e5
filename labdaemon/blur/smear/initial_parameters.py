"""Where fits begin: the cost of a smear is not convex in its amplitude."""

from __future__ import annotations

import numpy as np

from labdaemon.blur.motion import Defocus
from labdaemon.blur.patch.illumination import render_illumination, solve_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.spectra import closed_form


def initial_parameters(sharp: SharpTarget, problem: FitProblem, blur: Defocus, k: int) -> list[FloatArray]:
    """Parameters to start from: the smear's own moments, or for a texture several, its cost being not convex.

    A texture's sharp frame may have been taken anywhere on its path, so each amplitude is tried from both ends too.
    """
    if problem.blob is not None:
        spread = 2 * (problem.blob.moment_px2 - sharp.form.moment_px2 - blur.mean_px2 * np.eye(2))
        values, vectors = np.linalg.eigh(spread)
        moment = vectors @ np.diag(np.maximum(values, 0.02)) @ vectors.T
        guess = [moment[0, 0], moment[0, 1], moment[1, 1]]
        return [np.concatenate((problem.initial_centre_px, [blur.mean_px2], np.zeros(k), guess))]
    starts: list[FloatArray] = []
    for amplitude in (0.7, 2.5, 6.0):
        for angle in (0.0, np.pi / 4, np.pi / 2, 3 * np.pi / 4):
            a = amplitude * np.array([np.cos(angle), np.sin(angle)])
            guess = [a[0] ** 2 + 0.02, a[0] * a[1], a[1] ** 2 + 0.02]
            for side in (-1, 0, 1):
                place = problem.initial_centre_px + side * a
                starts.append(np.concatenate((place, [blur.mean_px2], np.zeros(k), guess)))
    model = fast_forward_model(problem, closed_form.orbit_transfer)
    costs = []
    for start in starts:
        dark, _ = model(start)
        weight = pixel_weights(sharp, problem.planes)(np.maximum(problem.planes.values, 0))
        light = solve_illumination(problem.planes, weight, dark)
        costs.append(
            float(np.sum(weight * (problem.planes.values - render_illumination(problem.planes, light, dark)) ** 2))
        )
    return [starts[index] for index in np.argsort(costs)[:4]]
