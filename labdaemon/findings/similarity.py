"""From one survey's axes to another's: rotation, translation and scale between two sets of points.

Umeyama 1991, doi:10.1109/34.88573.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.response import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """``p' = scale · rotation · p + translation``.

    Attributes
    ----------
    rotation, translation_mm, scale
        (3, 3), (3,) and a factor.
    rms_mm
        Root mean square distance that remains.
    """

    rotation: FloatArray
    translation_mm: FloatArray
    scale: float
    rms_mm: float

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation."""
        return float(np.degrees(np.arccos(np.clip((np.trace(self.rotation) - 1) / 2, -1, 1))))


def fit_similarity(points_mm: FloatArray, onto_mm: FloatArray) -> Similarity | None:
    """Best similarity of points (n, 3) onto others; None for fewer than three, or points on a line."""
    if len(points_mm) < 3:
        return None
    middle, onto = points_mm.mean(axis=0), onto_mm.mean(axis=0)
    one, two = points_mm - middle, onto_mm - onto
    left, size, right = np.linalg.svd(two.T @ one)
    if size[1] <= 1e-4 * size[0]:
        return None
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    rotation = left @ np.diag(mirror) @ right
    scale = float(np.sum(size * mirror) / np.sum(one**2))
    rest = two - scale * one @ rotation.T
    rms = float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
    return Similarity(rotation, onto - scale * rotation @ middle, scale, rms)
