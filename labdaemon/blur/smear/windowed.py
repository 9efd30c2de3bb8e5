"""Models of motion seen through known windows: one or several frames, each frame's mean position its own.

The parameters are x, y and extra blur of each frame, then the shape's, then the motion's: the vector v of a standing
motion v·sin(ωt + ψ) at a held phase ψ, the same with its phase, or the vectors a and b of an orbit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labdaemon.blur.law import nodes_transfer, standing_transfer, window_nodes
from labdaemon.blur.motion import ExtraBlur, Window
from labdaemon.blur.patch.light import light_level
from labdaemon.blur.patch.mosaic import Planes
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights, shape_precision
from labdaemon.blur.smear.model import Motion, Setting, blurred_model
from labdaemon.blur.solver.normal import Prior, Solution
from labdaemon.blur.solver.solve import Model

FRAME = 3  # x, y, extra blur: the parameters of each frame, before the shape's and the motion's

MotionOf = Callable[[FloatArray, FloatArray], Motion]
"""From the nodes of a frame's window (2, K) and their weights (K,) to the motion's transfer function."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """A target in the frames that are measured together.

    Attributes
    ----------
    sharp
        The target at rest.
    settings, windows, blurs
        One of each a frame.
    planes
        All frames' pixels.
    """

    sharp: SharpTarget
    settings: list[Setting]
    windows: list[Window]
    blurs: list[ExtraBlur]
    planes: Planes

    @classmethod
    def of(
        cls, sharp: SharpTarget, settings: list[Setting], windows: Sequence[Window], blurs: Sequence[ExtraBlur]
    ) -> Exposures:
        """Put frames together."""
        return cls(sharp, settings, list(windows), list(blurs), stack([s.planes for s in settings]))

    @property
    def shape_count(self) -> int:
        """How many parameters the target's shape has."""
        return self.settings[0].shapes

    @property
    def first_motion(self) -> int:
        """Place of the first parameter of the motion."""
        return FRAME * len(self.settings) + self.shape_count

    def weights(self, signal: FloatArray) -> FloatArray:
        """Inverse variances of all pixels by the modelled values."""
        return pixel_weights(self.sharp, self.planes)(signal)

    def prior(self, motion_count: int) -> Prior:
        """Defocus from the controls, shape from the sharp frame; nothing is known of places and motion."""
        k, shape = self.shape_count, slice(self.first_motion - self.shape_count, self.first_motion)
        size = self.first_motion + motion_count
        precision, mean = np.zeros((size, size)), np.zeros(size)
        for index, blur in enumerate(self.blurs):
            precision[FRAME * index + 2, FRAME * index + 2] = 1 / max(blur.sd_px2, 1e-4) ** 2
            mean[FRAME * index + 2] = blur.mean_px2
        if k:
            precision[shape, shape] = shape_precision(self.sharp)
        return Prior(mean, precision)

    def begin(self, a: FloatArray, b: FloatArray, motion: FloatArray) -> FloatArray:
        """Parameters to start from; a smear's middle is the mean place plus what the window adds to it."""
        frames = []
        for setting, window, blur in zip(self.settings, self.windows, self.blurs, strict=True):
            basis, weight = window_nodes(window, 3.0)
            place = setting.start_px - a * (basis[0] @ weight) - b * (basis[1] @ weight)
            frames += [*place, blur.mean_px2]
        return np.concatenate((frames, np.zeros(self.shape_count), motion))

    def model(self, motion_of: MotionOf, reach_px: float) -> Model:
        """Darkness of all frames' pixels and its derivatives.

        Parameters
        ----------
        motion_of
            The kind of motion, one of `orbit_motion`, `phase_motion` and `standing_motion(ψ)`.
        reach_px
            Largest amplitude to be represented.
        """
        count, lattices = len(self.settings), len(self.settings[0].planes.channel)
        shape = self.planes.values.shape
        models = [
            blurred_model(setting, motion_of(*window_nodes(window, reach_px)))
            for setting, window in zip(self.settings, self.windows, strict=True)
        ]

        def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
            dark, by_p = np.zeros(shape), np.zeros((len(p), *shape))
            for index, (one, setting) in enumerate(zip(models, self.settings, strict=True)):
                own = np.concatenate((p[FRAME * index : FRAME * index + FRAME], p[FRAME * count :]))
                image, slopes = one(own)
                rows = slice(lattices * index, lattices * (index + 1))
                _, height, width = setting.planes.values.shape
                dark[rows, :height, :width] = image
                by_p[FRAME * index : FRAME * index + FRAME, rows, :height, :width] = slopes[:FRAME]
                by_p[FRAME * count :, rows, :height, :width] = slopes[FRAME:]
            return dark, by_p

        return models[0] if count == 1 else model

    def held_shape(self) -> Exposures:
        """The same with the target's shape held."""
        return replace(self, settings=[replace(one, target=one.target.rigid) for one in self.settings])


def orbit_motion(basis: FloatArray, weight: FloatArray) -> Motion:
    """Motion by (ax, ay, bx, by)."""
    return partial(_at_nodes, basis=basis, weight=weight)


def phase_motion(basis: FloatArray, weight: FloatArray) -> Motion:
    """Standing motion by (vx, vy, ψ)."""
    return partial(_at_phase, basis=basis, weight=weight)


def standing_motion(phase_rad: float) -> MotionOf:
    """Standing motion by (vx, vy) at a held phase."""

    def motion(basis: FloatArray, weight: FloatArray) -> Motion:
        course = np.cos(phase_rad) * basis[0] + np.sin(phase_rad) * basis[1]
        return partial(_at_nodes, basis=course[None], weight=weight)

    return motion


def _at_nodes(
    fx: FloatArray, fy: FloatArray, vectors: FloatArray, *, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    return nodes_transfer(fx, fy, vectors, basis, weight)


def _at_phase(
    fx: FloatArray, fy: FloatArray, motion: FloatArray, *, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    return standing_transfer(fx, fy, motion, basis, weight)


def stack(parts: list[Planes]) -> Planes:
    """Patches of several frames as one, each lattice keeping its own place; smaller ones are padded with nothing."""
    if len(parts) == 1:
        return parts[0]
    height = max(p.values.shape[1] for p in parts)
    width = max(p.values.shape[2] for p in parts)
    values, valid, offsets = [], [], []
    origin = parts[0].origin_px
    for p in parts:
        pad = ((0, 0), (0, height - p.values.shape[1]), (0, width - p.values.shape[2]))
        values.append(np.pad(p.values, pad))
        valid.append(np.pad(p.valid, pad))
        offsets.append(p.offset_px + (np.asarray(p.origin_px) - np.asarray(origin)))
    channel = np.concatenate([p.channel for p in parts])
    return Planes(
        np.concatenate(values), np.concatenate(valid), channel, np.concatenate(offsets), parts[0].period, origin
    )


def timing_covariance(best: Solution, exposures: Exposures, motion_of: MotionOf) -> FloatArray:
    """Covariance that the windows' phase and length uncertainties add, by finite differences of the model."""
    size = len(best.p)
    total = np.zeros((size, size))
    windows = exposures.windows
    if all(window.sd_phase_rad <= 0 and window.sd_exposure_s <= 0 for window in windows):
        return total
    reach = 3.0 + 1.3 * float(np.linalg.norm(best.p[exposures.first_motion :]))
    base, _ = exposures.model(motion_of, reach)(best.p)
    level = light_level(exposures.planes, best.light) * best.light[:, 3, None, None]
    for index, window in enumerate(windows):
        later = replace(window, phase_rad=(window.phase_rad or 0.0) + window.sd_phase_rad)
        longer = replace(window, exposure_s=window.exposure_s + window.sd_exposure_s)
        for other, sd in ((later, window.sd_phase_rad), (longer, window.sd_exposure_s)):
            if sd <= 0:
                continue
            changed = replace(exposures, windows=[*windows[:index], other, *windows[index + 1 :]])
            moved, _ = changed.model(motion_of, reach)(best.p)
            shift = np.einsum("knhw,nhw->k", best.gain, -level * (moved - base))
            total += np.outer(shift, shift)
    return total
