"""Whether all parts of a textured patch move in the same way.

Strips and ninths of the box are asked for the change of place and motion that each would prefer, by its share of the
equations at the solution of the whole: no part is fitted by itself. A change counts when it exceeds both its standard
deviation and what the model's own faults could explain.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labdaemon.blur.motion import Measurement
from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.errors_in_variables import CorrectedEquations
from labdaemon.blur.smear.fit_problem import FitProblem
from labdaemon.blur.smear.frame_set import FrameSet, orbit_vectors
from labdaemon.blur.smear.texture_fit import TextureFit
from labdaemon.blur.smear.texture_frames import equations_of_frames
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.texture_settings import TEXTURE
from labdaemon.flags import Flag

FrameEquations = tuple[ColourPlanes, CorrectedEquations]


def motion_varies(problem: FitProblem, fit: TextureFit, path: FloatArray) -> bool:
    """Whether parts of the box ask for another motion over whole cycles than the whole of it.

    Parameters
    ----------
    problem, fit
        The patch and its fit by the second moment.
    path
        (2,) direction of the motion.
    """
    k = problem.shape_count
    c, s = path / max(float(np.hypot(*path)), 1e-12)
    ray = np.array([c * c, 2 * c * s, s * s])
    square = max(float(ray @ fit.p[3 + k :]), 0.0)
    least = max(TEXTURE.mixed_fraction * square, TEXTURE.mixed_least_px2)
    return _exceeds([(problem.planes, fit.equations)], 3, ray[None], least)


def flag_mixed_motion(found: Measurement, frame_set: FrameSet, solution: Solution) -> Measurement:
    """The measurement; with the flag `mixed_motion` where parts of a textured patch move differently.

    Parameters
    ----------
    found
        Of all frames together, through their windows.
    frame_set, solution
        The frames and the fit behind it.
    """
    equations = equations_of_frames(frame_set, solution)
    if not equations or not np.isfinite(found.a_px).all():
        return found
    vectors = orbit_vectors(solution.p[frame_set.first_motion :])
    size = float(np.linalg.norm(vectors))
    # The same limits as over whole cycles, where the squared amplitude changes by 2A·δA.
    least = max(TEXTURE.mixed_fraction * size**2, TEXTURE.mixed_least_px2) / (2 * max(size, 1e-3))
    if not _exceeds(equations, 4, _directions(vectors), least):
        return found
    return replace(found, flags=found.flags | {Flag.MIXED_MOTION})


def _directions(vectors: FloatArray) -> FloatArray:
    """(4, 4) unit changes of a and b: a longer path, another phase, another direction, and both of these."""
    (ax, ay), (bx, by) = vectors[:2], vectors[2:]
    rows = np.array([[ax, ay, bx, by], [-bx, -by, ax, ay], [-ay, ax, -by, bx], [by, -bx, -ay, ax]])
    result: FloatArray = rows / max(float(np.linalg.norm(vectors)), 1e-12)
    return result


def _exceeds(frames: Sequence[FrameEquations], count: int, rays: FloatArray, least: float) -> bool:
    """Whether a part of the box asks for a change of more than `least` along one of the rays (r, count)."""
    return any(
        bool(np.any(np.abs(change) > np.maximum(least, TEXTURE.mixed_sds * sd)))
        for change, sd in _changes_of_parts(frames, count, rays)
    )


def _parts(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    height, width = shape
    whole = (slice(0, height), slice(0, width))
    down = [slice(height * i // 3, height * (i + 1) // 3) for i in range(3)]
    across = [slice(width * i // 3, width * (i + 1) // 3) for i in range(3)]
    return [
        *((rows, whole[1]) for rows in down),
        *((whole[0], columns) for columns in across),
        *((rows, columns) for rows in down for columns in across),
    ]


def _changes_of_parts(
    frames: Sequence[FrameEquations], count: int, rays: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Change of the motion's `count` parameters along each of the `rays` that a part of the box asks for, and its sd.

    Each frame has a place of its own, its first two parameters; the motion's are the last before the contrast.
    """
    images = [
        (merge_planes(planes, state.jacobian), merge_planes(planes, state.residual), state) for planes, state in frames
    ]
    size = 2 * len(frames) + count
    target = np.concatenate((np.zeros((len(rays), 2 * len(frames))), rays), axis=1).T
    for rows, columns in _parts(images[0][1].shape):
        score, raw, information = np.zeros(size), np.zeros((size, size)), np.zeros((size, size))
        squares, pixels, expected = 0.0, 0, 0.0
        for frame, (jacobian, residual, here) in enumerate(images):
            pick = [0, 1, *range(len(jacobian) - 1 - count, len(jacobian) - 1)]
            places = [2 * frame, 2 * frame + 1, *range(2 * len(frames), size)]
            own, left = jacobian[pick, rows, columns].reshape(len(pick), -1), residual[rows, columns].ravel()
            scale = here.pixels * left.size / max(here.residual.size, 1) * here.noise_power * here.template_share
            product = own @ own.T
            score[places] += own @ left + 0.5 * scale * here.moments.through_slopes[pick]
            raw[np.ix_(places, places)] += product
            information[np.ix_(places, places)] += product - scale * here.moments.bends[np.ix_(pick, pick)]
            squares, pixels = squares + float(left @ left), pixels + left.size
            expected += here.noise_power * here.widening / len(images)
        unit = np.sqrt(np.maximum(np.diag(raw), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
        good = values > TEXTURE.part_share
        if not good.any():
            continue
        inverse = (vectors[:, good] / values[good]) @ vectors[:, good].T / np.outer(unit, unit)
        power = max(squares / max(pixels - size, 1), expected)
        spread = np.diag(target.T @ inverse @ raw @ inverse @ target) * power
        yield target.T @ inverse @ score, np.sqrt(np.maximum(spread, 0.0))
