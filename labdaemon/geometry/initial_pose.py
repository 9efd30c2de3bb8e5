"""Rough camera positions to start an adjustment from: every solution of many small sets of points."""

from __future__ import annotations

from itertools import combinations, islice

import cv2
import numpy as np

from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray
from labdaemon.geometry.oriented_camera import OrientedCamera, rotation_from_vector
from labdaemon.geometry.settings import ORIENTATION


def initial_cameras(lens: Lens, image_px: FloatArray, object_mm: FloatArray) -> list[OrientedCamera]:
    """Views that three of the points fit exactly, and ones that fit all of them roughly.

    Parameters
    ----------
    lens
        Interior orientation.
    image_px, object_mm
        (n, 2) and (n, 3), n >= 4.

    Returns
    -------
    list of View
        The best few with most points in front of the camera, best first; empty if there is none.
    """
    slopes = lens.undistort(image_px)
    seen = np.flatnonzero(np.isfinite(slopes).all(axis=1))
    if len(seen) < 4:
        return []
    slopes, points = slopes[seen], object_mm[seen]
    origin = points.mean(axis=0)  # numbers of a site grid are large
    local = points - origin
    poses: list[tuple[FloatArray, FloatArray]] = []
    for triple in _sample_triples(len(seen)):
        index = list(triple)
        if _triangle_area(slopes[index]) < 1e-9:
            continue
        count, vectors, shifts = cv2.solveP3P(
            local[index].reshape(3, 1, 3), slopes[index].reshape(3, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_P3P
        )
        poses += [(_flatten(vectors[i]), _flatten(shifts[i])) for i in range(count)]
    for method in (cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_EPNP):
        found, rotation, translation = cv2.solvePnP(
            local.reshape(-1, 1, 3), slopes.reshape(-1, 1, 2), np.eye(3), None, flags=method
        )
        if found:
            poses.append((_flatten(rotation), _flatten(translation)))
    good = [(vector, shift) for vector, shift in poses if np.isfinite([*vector, *shift]).all()]
    if not good:
        return []
    rotations = np.stack([rotation_from_vector(vector) for vector, _ in good])
    seen_points = np.einsum("mij,nj->mni", rotations, local) + np.stack([shift for _, shift in good])[:, None]
    depth = np.where(seen_points[..., 2] > 0, seen_points[..., 2], np.nan)
    misses = np.sum((seen_points[..., :2] / depth[..., None] - slopes) ** 2, axis=-1)
    # A gross error must cost no more than a large residual does, a point behind the camera as much.
    score = np.log1p(np.nan_to_num(misses, nan=1e6) / ORIENTATION.initial_slope_error**2).sum(axis=1)
    ahead = np.median(seen_points[..., 2], axis=1) > 0
    best = [i for i in np.argsort(score).tolist() if ahead[i]][: ORIENTATION.max_initial_cameras]
    return [OrientedCamera(lens, rotations[i], origin - rotations[i].T @ good[i][1]) for i in best]


def _sample_triples(count: int) -> list[tuple[int, ...]]:
    """Some triples of n points: all of a few, an even sample of many."""
    total = count * (count - 1) * (count - 2) // 6
    if total <= ORIENTATION.max_triples:
        return list(combinations(range(count), 3))
    if total <= 200_000:
        return list(islice(combinations(range(count), 3), 0, None, total // ORIENTATION.max_triples))
    generator = np.random.default_rng(count)
    return [tuple(int(i) for i in generator.choice(count, 3, replace=False)) for _ in range(ORIENTATION.max_triples)]


def _triangle_area(slopes: FloatArray) -> float:
    """Twice the area of a triangle of slopes."""
    first, second = slopes[1] - slopes[0], slopes[2] - slopes[0]
    return float(abs(first[0] * second[1] - first[1] * second[0]))


def _flatten(column: object) -> FloatArray:
    """Flatten what OpenCV returns."""
    return np.asarray(column, dtype=float).ravel()
