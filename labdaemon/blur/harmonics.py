"""Harmonics of a target's motion, as a gauge that moves with it shows them.

A motion whose fundamental is v·sin(θ + ψ) has harmonics that go with it,

    d(θ) = v·[ sin(θ + ψ) + Σ r_n sin(n(θ + ψ) + δ_n) ],   n = 2, 3 …,

with r_n and δ_n the same for all points that move together. A 5 % third harmonic moves the ends of the path, where the
target dwells, by up to 5 %: a fit of a pure sinusoid is then off by 1.7 %. For an orbit, which has no single phase, ψ
is that of its major axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.errors import UsageError

MIN_HARMONIC_SD = 1e-5
"""Standard deviation of a harmonic over the fundamental below which it adds nothing to the covariance."""


@dataclass(frozen=True, slots=True)
class MotionHarmonics:
    """Harmonics over the fundamental.

    Attributes
    ----------
    cosine, sine
        r_n cos δ_n and r_n sin δ_n for n = 2, 3 …
    sd, sd_sine
        Standard deviation of each of both, for n = 2, 3 …; the latter is that of the sine part where it is another.
    phase_rad
        ψ, phase of the fundamental against the window's reference.

    Raises
    ------
    UsageError
        Not one of each an order, numbers that are not finite, or harmonics as large as the fundamental.
    """

    cosine: tuple[float, ...]
    sine: tuple[float, ...]
    sd: tuple[float, ...]
    phase_rad: float = 0.0
    sd_sine: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not len(self.cosine) == len(self.sine) == len(self.sd):
            raise UsageError("give cosine, sine and standard deviation of each harmonic")
        values = (*self.cosine, *self.sine, *self.sd, self.phase_rad)
        if not all(map(math.isfinite, values)) or min(self.sd, default=0.0) < 0:
            raise UsageError("harmonics and their standard deviations must be finite")
        if self.sd_sine is not None and not len(self.sd_sine) == len(self.sd):
            raise UsageError("give a standard deviation of each sine part, or none")
        if self.size >= 1:
            raise UsageError("the harmonics are as large as the fundamental: this is no motion at one frequency")

    @property
    def size(self) -> float:
        """Root of the sum of all r_n²."""
        return math.hypot(*self.cosine, *self.sine)

    @property
    def sds(self) -> tuple[tuple[float, float], ...]:
        """Standard deviations of the cosine and the sine part of each order."""
        return tuple(zip(self.sd, self.sd if self.sd_sine is None else self.sd_sine, strict=True))

    @property
    def has_even(self) -> bool:
        """Whether an even harmonic exceeds three standard deviations: the motion is then no mirror image of itself."""
        even = zip(self.cosine[::2], self.sine[::2], self.sd[::2], strict=True)
        return any(math.hypot(c, s) > 3.0 * sd and (c or s) for c, s, sd in even)

    @property
    def bandwidth(self) -> float:
        """By how much finer than a sinusoid the motion has to be sampled: 1 + Σ n r_n."""
        pairs = zip(self.cosine, self.sine, strict=True)
        return 1.0 + sum(order * math.hypot(c, s) for order, (c, s) in enumerate(pairs, start=2))

    def at_phase(self, phase_rad: float) -> MotionHarmonics:
        """The same, of a motion whose fundamental has this phase."""
        return replace(self, phase_rad=phase_rad)

    def shifted(self, index: int, cosine: float, sine: float) -> MotionHarmonics:
        """The same with both parts of one harmonic (0: the second) changed by so much."""
        pairs = [list(self.cosine), list(self.sine)]
        pairs[0][index] += cosine
        pairs[1][index] += sine
        return replace(self, cosine=tuple(pairs[0]), sine=tuple(pairs[1]))

    def basis(self, angle_rad: FloatArray) -> FloatArray:
        """(2, K) what multiplies a and b at excitation phases (K,): sin θ and cos θ, each with its harmonics."""
        wave = np.exp(1j * angle_rad)
        for order, (cosine, sine) in enumerate(zip(self.cosine, self.sine, strict=True), start=2):
            turn = order * angle_rad + (order - 1) * self.phase_rad
            wave = wave + (cosine + 1j * sine) * np.exp(1j * turn)
        return np.stack((wave.imag, wave.real))
