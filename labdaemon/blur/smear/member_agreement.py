"""Whether the frames of a phased group show one motion: a χ² test of what each frame asks for at the joint solution.

At the solution of all frames together each frame's equations N·δ = g state the change δ of the motion that it would
prefer, its position, extra blur and light being free. Frames of one motion prefer changes as small as their noise: then
the sum of gᵀN⁻¹g over the frames, less the part of a change that they share, is χ² with as many degrees of freedom as
the frames determine more parameters than one motion has. A single frame does not determine every direction (a window
under constant light sees no phase), so that directions without information are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.illumination import render_illumination
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.frame_set import FRAME_PARAMETERS, FrameSet, orbit_vectors, window_orbit_transfer
from labdaemon.blur.smear.gls_frames import frame_products
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.flags import Flag

LEAST_SHARE = 1e-3
"""Information along a direction, over the largest, below which one frame does not show it. Trial: the model is curved
there, and the linear equations promise more than there is."""
CONTRADICTION_PROBABILITY = 1e-3
"""Probability of the χ² below which the frames contradict each other. Statistics; true groups stay far above, because
the floor below is generous."""
FRAME_FLOOR_PX = 0.0025
"""Error of each frame's motion that no sd states (interpolation, timing within its sd). Trial."""


def flag_contradiction(found: Measurement, frame_set: FrameSet, solution: Solution) -> Measurement:
    """The measurement; with the flag `contradicts_group` and a wider covariance where its frames differ.

    Parameters
    ----------
    found
        Of all frames together, with its phase.
    frame_set, solution
        The frames and the joint fit, by whatever parameters of the motion.
    """
    if len(frame_set.problems) < 2 or not frame_set.sharp.noise_known or not np.isfinite(found.a_px).all():
        return found
    squared, dof = member_chi2(frame_set, solution)
    if dof < 1 or squared < chi2.isf(CONTRADICTION_PROBABILITY, dof):
        return found
    return replace(
        found,
        flags=found.flags | {Flag.CONTRADICTS_GROUP},
        covariance_px2=found.covariance_px2 * (squared / dof),
    )


def member_chi2(frame_set: FrameSet, solution: Solution) -> tuple[float, int]:
    """χ² between the frames and its degrees of freedom, of the joint fit by an orbit or an in-phase motion."""
    first = frame_set.first_motion
    p = np.concatenate((solution.p[:first], orbit_vectors(solution.p[first:])))
    dark, _ = frame_set.forward_model(window_orbit_transfer, frame_set.max_amplitude_px(p))(p)
    at = replace(solution, p=p, signal=render_illumination(frame_set.planes, solution.light, dark))
    normals, scores = [], []
    for index, (_, products, _) in enumerate(frame_products(frame_set, at, window_orbit_transfer)):
        normal, score = _motion_equations(frame_set, index, at.p, products[:-1])
        # Residuals larger than the noise model make every difference larger; they have a flag of their own.
        normals.append(normal / max(solution.chi2, 1.0))
        scores.append(score / max(solution.chi2, 1.0))
    total = np.sum(normals, axis=0)
    shared = np.linalg.pinv(total, rcond=LEAST_SHARE, hermitian=True) @ np.sum(scores, axis=0)
    squared, rank = 0.0, 0
    for normal, score in zip(normals, scores, strict=True):
        one, directions = _explained(normal, score - normal @ shared)
        squared += one
        rank += directions
    return squared, rank - _explained(total, np.zeros(4))[1]


def _motion_equations(
    frame_set: FrameSet, index: int, p: FloatArray, equations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One frame's (4, 4) information on the motion and (4,) score; its position and extra blur are eliminated."""
    own = FRAME_PARAMETERS
    k = frame_set.shape_count + frame_set.ambient_count
    normal, score = equations[:, :-1].copy(), equations[:, -1].copy()
    blur = frame_set.blurs[index]
    precision = 1.0 / max(blur.sd_px2, 1e-4) ** 2
    normal[2, 2] += precision
    score[2] += precision * (blur.mean_px2 - p[FRAME_PARAMETERS * index + 2])
    inverse = np.linalg.pinv(normal[:own, :own], hermitian=True)
    motion = slice(own + k, own + k + 4)  # the shape is common, and known by all frames
    cross = normal[motion, :own] @ inverse
    return normal[motion, motion] - cross @ normal[:own, motion], score[motion] - cross @ score[:own]


def _explained(normal: FloatArray, score: FloatArray) -> tuple[float, int]:
    """scoreᵀ normal⁻¹ score over the directions that the normal matrix shows, and their number."""
    values, vectors = np.linalg.eigh(normal)
    shown = values > LEAST_SHARE * max(float(values[-1]), 1e-300)
    along = (vectors.T @ score)[shown]
    # What no sd states (timing aside) is as if each frame had a little noise more.
    information = values[shown] + FRAME_FLOOR_PX**2 * values[shown] ** 2
    return float(np.sum(along**2 / information)), int(np.count_nonzero(shown))
