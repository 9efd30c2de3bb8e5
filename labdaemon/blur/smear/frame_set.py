"""Models of motion seen through known windows: one or several frames, each frame's mean position its own.

The parameters are x, y and extra blur of each frame, then the shape's, then (where it is not known exactly) the
correction of the ambient light under coded light, then the motion's: the vector v of an in-phase
motion v·sin(ωt + ψ) at a held phase ψ, the same with its phase, or the vectors a and b of an orbit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labdaemon.blur.motion import Defocus, ExposureWindow
from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.weights import pixel_weights, shape_precision
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.reduced_equations import Prior
from labdaemon.blur.solver.solve import DarknessModel
from labdaemon.blur.waveform import in_phase_transfer, light_parts, quadrature_transfer, window_nodes

FRAME_PARAMETERS = 3  # x, y, extra blur: the parameters of each frame, before the shape's and the motion's

TransferFactory = Callable[[FloatArray, FloatArray], TransferFunction]
"""From the nodes of a frame's window (2, K) and their weights (K,) to the motion's transfer function."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """A target in the frames that are measured together.

    Attributes
    ----------
    sharp
        The target at rest.
    problems, windows, blurs
        One of each a frame.
    planes
        All frames' pixels.
    ambient_held
        Whether the stated ambient light is taken for exact.
    moment_px2
        (2, 2) aaᵀ + bbᵀ as a model of whole cycles reads it, where that is known; None takes it from the smears.
    """

    sharp: SharpTarget
    problems: list[FitProblem]
    windows: list[ExposureWindow]
    blurs: list[Defocus]
    planes: ColourPlanes
    ambient_held: bool = False
    moment_px2: FloatArray | None = None

    @classmethod
    def from_problems(
        cls, sharp: SharpTarget, problems: list[FitProblem], windows: Sequence[ExposureWindow], blurs: Sequence[Defocus]
    ) -> FrameSet:
        """Put frames together."""
        return cls(sharp, problems, list(windows), list(blurs), stack_planes([s.planes for s in problems]))

    @property
    def shape_count(self) -> int:
        """How many parameters the target's shape has."""
        return self.problems[0].shape_count

    @property
    def ambient_count(self) -> int:
        """1 where the ambient light is a parameter: its correction is common to all frames."""
        return int(not self.ambient_held and self.sd_ambient > 0)

    @property
    def sd_ambient(self) -> float:
        """Standard deviation of the ambient light under coded light; 0 where it does not matter."""
        return max((w.light.sd_ambient for w in self.windows if w.is_coded and w.light is not None), default=0.0)

    @property
    def nuisance_count(self) -> int:
        """Parameters between the frames' and the motion's."""
        return self.shape_count + self.ambient_count

    @property
    def first_motion(self) -> int:
        """Place of the first parameter of the motion."""
        return FRAME_PARAMETERS * len(self.problems) + self.nuisance_count

    @property
    def shows_phase(self) -> bool:
        """Whether the frames together show the phase: several openings, or coded light."""
        return len(self.windows) > 1 or any(window.is_coded for window in self.windows)

    def rows(self, index: int) -> slice:
        """Rows of one frame's colour planes among all."""
        count = len(self.problems[0].planes.channel)
        return slice(count * index, count * (index + 1))

    def planes_of(self, index: int) -> ColourPlanes:
        """One frame's pixels, padded as among all: light is fitted in the coordinates of the padded planes."""
        rows, own = self.rows(index), self.problems[index].planes
        return replace(own, values=self.planes.values[rows], valid=self.planes.valid[rows])

    def weights(self, signal: FloatArray) -> FloatArray:
        """Inverse variances of all pixels by the modelled values."""
        return pixel_weights(self.sharp, self.planes)(signal)

    def prior(self, motion_count: int) -> Prior:
        """Defocus from the controls, shape from the sharp frame; nothing is known of places and motion."""
        k, first = self.shape_count, FRAME_PARAMETERS * len(self.problems)
        shape = slice(first, first + k)
        size = self.first_motion + motion_count
        precision, mean = np.zeros((size, size)), np.zeros(size)
        for index, blur in enumerate(self.blurs):
            precision[FRAME_PARAMETERS * index + 2, FRAME_PARAMETERS * index + 2] = 1 / max(blur.sd_px2, 1e-4) ** 2
            mean[FRAME_PARAMETERS * index + 2] = blur.mean_px2
        if k:
            precision[shape, shape] = shape_precision(self.sharp)
        if self.ambient_count:
            precision[first + k, first + k] = self.sd_ambient**-2
        return Prior(mean, precision)

    def initial_parameters(self, a: FloatArray, b: FloatArray, motion: FloatArray) -> FloatArray:
        """Parameters to start from; a smear's middle is the mean place plus what the window adds to it."""
        frames = []
        for problem, window, blur in zip(self.problems, self.windows, self.blurs, strict=True):
            basis, weight = window_nodes(window, 3.0)
            place = problem.initial_centre_px - a * (basis[0] @ weight) - b * (basis[1] @ weight)
            frames += [*place, blur.mean_px2]
        return np.concatenate((frames, np.zeros(self.nuisance_count), motion))

    def max_amplitude_px(self, p: FloatArray) -> float:
        """Largest amplitude that a model at p must represent: no motion is longer than its patch, whatever p says."""
        height, width = self.problems[0].grid.size
        return 3.0 + 1.3 * min(float(np.linalg.norm(p[self.first_motion :])), float(np.hypot(height, width)))

    def forward_model(
        self, transfer_factory: TransferFactory, max_amplitude_px: float, *, exact: bool = False
    ) -> DarknessModel:
        """Darkness of all frames' pixels and its derivatives.

        Parameters
        ----------
        transfer_factory
            The kind of motion: `window_orbit_transfer`, `window_in_phase_transfer` or `window_fixed_phase_transfer(ψ)`.
        max_amplitude_px
            Largest amplitude to be represented.
        """
        count, plane_count = len(self.problems), len(self.problems[0].planes.channel)
        shape = self.planes.values.shape
        models = [
            fast_forward_model(problem, self.transfer(window, transfer_factory, max_amplitude_px), exact=exact)
            for problem, window in zip(self.problems, self.windows, strict=True)
        ]

        def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
            dark, by_p = np.zeros(shape), np.zeros((len(p), *shape))
            for index, (one, problem) in enumerate(zip(models, self.problems, strict=True)):
                own = np.concatenate(
                    (
                        p[FRAME_PARAMETERS * index : FRAME_PARAMETERS * index + FRAME_PARAMETERS],
                        p[FRAME_PARAMETERS * count :],
                    )
                )
                image, slopes = one(own)
                rows = slice(plane_count * index, plane_count * (index + 1))
                _, height, width = problem.planes.values.shape
                dark[rows, :height, :width] = image
                by_p[FRAME_PARAMETERS * index : FRAME_PARAMETERS * index + FRAME_PARAMETERS, rows, :height, :width] = (
                    slopes[:FRAME_PARAMETERS]
                )
                by_p[FRAME_PARAMETERS * count :, rows, :height, :width] = slopes[FRAME_PARAMETERS:]
            return dark, by_p

        return models[0] if count == 1 else model

    def transfer(
        self, window: ExposureWindow, transfer_factory: TransferFactory, max_amplitude_px: float
    ) -> TransferFunction:
        """Transfer function of a frame's window; the correction of the ambient light is its first parameter."""
        if not self.ambient_count:
            return transfer_factory(*window_nodes(window, max_amplitude_px))
        return ambient_transfer(window, transfer_factory, max_amplitude_px)

    def with_fixed_shape(self) -> FrameSet:
        """The same with the target's shape and the ambient light held."""
        return replace(
            self,
            problems=[replace(one, rest_spectra=one.rest_spectra.fixed_shape) for one in self.problems],
            ambient_held=True,
        )


def ambient_transfer(
    window: ExposureWindow, transfer_factory: TransferFactory, max_amplitude_px: float
) -> TransferFunction:
    """Transfer function by (correction of the ambient light, motion…): lamp and room by their share of light.

    Parameters
    ----------
    window
        With its light; constant light has no ambient part.
    transfer_factory
        The kind of motion.
    max_amplitude_px
        Largest amplitude to be represented.
    """
    light = window.light if window.is_coded else None
    if light is None:
        plain = transfer_factory(*window_nodes(window, max_amplitude_px))

        def constant(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
            transfer, slopes = plain(fx, fy, p[1:])
            none = np.zeros((1, *np.shape(transfer)))
            return np.asarray(transfer, np.complex128), np.concatenate((none, slopes))

        return constant
    parts = light_parts(window, max_amplitude_px)
    by_lamp, by_room = transfer_factory(*parts.lamp), transfer_factory(*parts.room)

    def motion(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        (lamp, lamp_slopes), (room, room_slopes) = by_lamp(fx, fy, p[1:]), by_room(fx, fy, p[1:])
        room_light = (light.ambient + float(p[0])) * parts.room_cycles
        total = max(parts.lamp_cycles + room_light, 0.1 * parts.lamp_cycles)
        share = room_light / total
        by_ambient = (room - lamp) * (parts.lamp_cycles * parts.room_cycles / total**2)
        slopes = (1 - share) * lamp_slopes + share * room_slopes
        transfer = np.asarray((1 - share) * lamp + share * room, np.complex128)
        return transfer, np.concatenate((by_ambient[None], slopes))

    return motion


def window_orbit_transfer(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    """Motion by (ax, ay, bx, by)."""
    return partial(_orbit_at_nodes, basis=basis, weight=weight)


def orbit_vectors(motion: FloatArray) -> FloatArray:
    """(4,) a and b of an orbit's parameters, or of an in-phase motion's vector and phase."""
    if len(motion) == 4:
        return motion
    vector, phase_rad = motion[:2], float(motion[2])
    return np.concatenate((vector * np.cos(phase_rad), vector * np.sin(phase_rad)))


def window_in_phase_transfer(basis: FloatArray, weight: FloatArray) -> TransferFunction:
    """In-phase motion by (vx, vy, ψ)."""
    return partial(_in_phase_at_nodes, basis=basis, weight=weight)


def window_fixed_phase_transfer(phase_rad: float) -> TransferFactory:
    """In-phase motion by (vx, vy) at a held phase."""

    def motion(basis: FloatArray, weight: FloatArray) -> TransferFunction:
        waveform = np.cos(phase_rad) * basis[0] + np.sin(phase_rad) * basis[1]
        return partial(_orbit_at_nodes, basis=waveform[None], weight=weight)

    return motion


def _orbit_at_nodes(
    fx: FloatArray, fy: FloatArray, vectors: FloatArray, *, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    return quadrature_transfer(fx, fy, vectors, basis, weight)


def _in_phase_at_nodes(
    fx: FloatArray, fy: FloatArray, motion: FloatArray, *, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    return in_phase_transfer(fx, fy, motion, basis, weight)


def stack_planes(parts: list[ColourPlanes]) -> ColourPlanes:
    """Patches of several frames as one; each colour plane keeps its position, smaller ones are padded."""
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
    return ColourPlanes(
        np.concatenate(values), np.concatenate(valid), channel, np.concatenate(offsets), parts[0].period, origin
    )
