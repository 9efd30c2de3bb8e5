"""Which motions of a target's images are intersected with each other: those that may be one motion in space.

A camera that shows the phase offers its motion and the few twins that it does not exclude. A camera that hardly shows
it, because it looks along the path, offers a row of motions along an arc of phases. Of these only some go with what the
other cameras show, by the rays and by the prior of motions in phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from labdaemon.geometry.motion import FloatArray, ImageMotion
from labdaemon.geometry.orbit_prior import AxisRatio, OrbitPrior
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.geometry.settings import INTERSECTION

Combination = tuple[ImageMotion, ...]
"""One motion of each image."""


def combine_images(
    cameras: Sequence[OrientedCamera], motions: Sequence[ImageMotion], mean_mm: FloatArray, prior: OrbitPrior
) -> list[Combination]:
    """Combinations of the images' motions, the most likely first by the images alone.

    Parameters
    ----------
    cameras, motions
        One of each a camera, with alternatives and arcs; at least one without an arc.
    mean_mm
        (3,) about where the target is.
    prior
        Of motions in phase and orbits.

    Returns
    -------
    list of tuple of ImageMotion
        At most `INTERSECTION.max_combinations` by the cameras that show the phase, each with those motions of the
        other cameras that go with it.
    """
    clear = [index for index, motion in enumerate(motions) if not motion.arc]
    choices = [
        sorted(motions[index].row, key=lambda one: one.excess)[: INTERSECTION.max_alternatives] for index in clear
    ]
    leading = sorted(product(*choices), key=lambda chosen: sum(one.excess for one in chosen))
    leading = leading[: INTERSECTION.max_combinations]
    if len(clear) == len(motions):
        return leading
    by_motion = [np.kron(np.eye(2), camera.project_with_jacobians(mean_mm[None])[1][0]) for camera in cameras]
    found: list[Combination] = []
    for chosen in leading:
        known = _VectorEquations.of([by_motion[index] for index in clear], chosen)
        offered = []
        for index, motion in enumerate(motions):
            if index in clear:
                offered.append([chosen[clear.index(index)]])
                continue
            costs = [(known.joined(by_motion[index], one).cost(prior) + one.excess, one) for one in motion.row]
            costs.sort(key=lambda entry: entry[0])
            near = [one for cost, one in costs if cost - costs[0][0] < INTERSECTION.negligible_cost]
            offered.append(near[: INTERSECTION.max_arc_motions])
        found += list(product(*offered))[: INTERSECTION.max_combinations]
    return sorted(found, key=lambda one: sum(motion.excess for motion in one))


@dataclass(frozen=True, slots=True, eq=False)
class _VectorEquations:
    """Signed vectors in space by their images, to first order: normal equations, and the sum of squares of images."""

    normal: FloatArray
    right: FloatArray
    squares: float

    @classmethod
    def of(cls, by_motion: Sequence[FloatArray], images: Sequence[ImageMotion]) -> _VectorEquations:
        fit = cls(np.zeros((6, 6)), np.zeros(6), 0.0)
        for design, image in zip(by_motion, images, strict=True):
            fit = fit.joined(design, image)
        return fit

    def joined(self, design: FloatArray, image: ImageMotion) -> _VectorEquations:
        """With another image."""
        seen = np.concatenate((image.a_px, image.b_px))
        weight = np.linalg.inv(image.covariance_px2[2:, 2:] + INTERSECTION.floor_px2 * np.eye(4))
        return _VectorEquations(
            self.normal + design.T @ weight @ design,
            self.right + design.T @ weight @ seen,
            self.squares + float(seen @ weight @ seen),
        )

    def cost(self, prior: OrbitPrior) -> float:
        """Squared residuals, and what the prior has against the ratio of the axes."""
        covariance = np.zeros((9, 9))
        covariance[3:, 3:] = np.linalg.pinv(self.normal, hermitian=True)
        vectors = covariance[3:, 3:] @ self.right
        ratio = AxisRatio.of_motion(np.concatenate((np.zeros(3), vectors)).reshape(3, 3), covariance)
        cost = self.squares - float(self.right @ vectors)
        return cost if ratio is None else cost + ratio.penalty(prior)
