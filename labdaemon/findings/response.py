"""The motion of all targets over a series of steps, as arrays: what a modal model is fitted to.

A point moves as ``d(t) = a sin ωt + b cos ωt``, which is the imaginary part of ``(a + ib)·exp(iωt)``. So a + ib is the
complex amplitude, and divided by the table's amplitude it is a frequency response.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]

FREE_PHASE_RAD = np.inf
"""Standard deviation of a phase that nothing determines."""


class PhaseReference(Enum):
    """To what the phases of a response refer."""

    TABLE = "table"
    """To the table's motion, as well as `ResponseSeries.sd_phase_rad` says: complex frequency responses."""
    STEP = "step"
    """One unknown phase a step, common to all targets: signed amplitudes."""
    TARGET = "target"
    """One unknown phase a target and step: amplitudes only (whole cycles under constant light)."""


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSeries:
    """Response of targets (T) in directions (D) at steps (K) of a sweep.

    Attributes
    ----------
    frequency_hz
        (K,) excitation.
    amplitude
        (K, T, D) complex a + ib, mm; NaN where not measured.
    sd_real, sd_imag
        (K, T, D) standard deviations of a and of b, mm.
    table_mm
        (K,) amplitude of the table, zero to peak; ones for frequency response functions.
    sd_table
        (K,) relative standard deviation of `table_mm`; 0 where it is exact.
    phase
        What the phases refer to.
    at_rest
        (K, T) where the amplitude is below the detection limit, so that only its square has a normal error.
    targets
        Names, T of them.
    signed
        (K,) steps of a series without phase whose targets have phases relative to each other all the same: coded light
        or a phase group among captures of whole cycles under constant light. None: no step.
    sd_phase_rad
        (K,) standard deviation of the table's own phase at each step, common to all targets; infinite where nothing
        shows it. None: 0 with phases that refer to the table, infinite without.
    """

    frequency_hz: FloatArray
    amplitude: ComplexArray
    sd_real: FloatArray
    sd_imag: FloatArray
    table_mm: FloatArray
    sd_table: FloatArray
    phase: PhaseReference = PhaseReference.TABLE
    at_rest: BoolArray | None = None
    targets: tuple[str, ...] = field(default=())
    sd_phase_rad: FloatArray | None = None
    signed: BoolArray | None = None

    def __post_init__(self) -> None:
        """Check shapes.

        Raises
        ------
        ValueError
            An array has another shape, or a frequency or an amplitude of the table is not positive.
        """
        steps, targets, directions = self.amplitude.shape
        for name in ("sd_real", "sd_imag"):
            if getattr(self, name).shape != (steps, targets, directions):
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not {self.amplitude.shape}")
        for name in ("frequency_hz", "table_mm", "sd_table"):
            if getattr(self, name).shape != (steps,):
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, not ({steps},)")
        if self.sd_phase_rad is not None and self.sd_phase_rad.shape != (steps,):
            raise ValueError(f"sd_phase_rad has shape {self.sd_phase_rad.shape}, not ({steps},)")
        if steps and not (np.all(self.frequency_hz > 0) and np.all(self.table_mm > 0)):
            raise ValueError("frequencies and amplitudes of the table must be positive")
        if self.targets and len(self.targets) != targets:
            raise ValueError(f"{len(self.targets)} names for {targets} targets")

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.frequency_hz)

    def valid(self) -> BoolArray:
        """(K, T, D) whether there is a number with a standard deviation."""
        result: BoolArray = (
            np.isfinite(self.amplitude)
            & (self.sd_real > 0)
            & np.isfinite(self.sd_real)
            & (self.sd_imag > 0)
            & np.isfinite(self.sd_imag)
        )
        return result

    def resting(self) -> BoolArray:
        """(K, T) `at_rest`, nowhere where it was not given."""
        return np.zeros(self.amplitude.shape[:2], bool) if self.at_rest is None else self.at_rest

    def sd_phase(self) -> FloatArray:
        """(K,) `sd_phase_rad`, or what it is where it was not given."""
        if self.sd_phase_rad is not None:
            return self.sd_phase_rad
        return np.full(self.steps, 0.0 if self.phase is PhaseReference.TABLE else FREE_PHASE_RAD)

    def signed_steps(self) -> BoolArray:
        """(K,) `signed`, nowhere where it was not given."""
        return np.zeros(self.steps, bool) if self.signed is None else self.signed

    def subset(self, steps: NDArray[np.intp] | BoolArray) -> ResponseSeries:
        """The same targets at some of the steps."""
        return replace(
            self,
            frequency_hz=self.frequency_hz[steps],
            amplitude=self.amplitude[steps],
            sd_real=self.sd_real[steps],
            sd_imag=self.sd_imag[steps],
            table_mm=self.table_mm[steps],
            sd_table=self.sd_table[steps],
            at_rest=None if self.at_rest is None else self.at_rest[steps],
            sd_phase_rad=None if self.sd_phase_rad is None else self.sd_phase_rad[steps],
            signed=None if self.signed is None else self.signed[steps],
        )

    def with_targets(self, indices: NDArray[np.intp]) -> ResponseSeries:
        """The same steps for some of the targets."""
        return replace(
            self,
            amplitude=self.amplitude[:, indices],
            sd_real=self.sd_real[:, indices],
            sd_imag=self.sd_imag[:, indices],
            at_rest=None if self.at_rest is None else self.at_rest[:, indices],
            targets=tuple(self.targets[i] for i in indices) if self.targets else (),
        )


def frequency_response(frequency_hz: FloatArray, values: ComplexArray, sd: FloatArray | float = 1.0) -> ResponseSeries:
    """Complex spectra (K, T) or (K, T, D) as a series with an exact input.

    Parameters
    ----------
    frequency_hz
        (K,).
    values
        Frequency response functions, or spectra of free decays.
    sd
        Standard deviation of real and imaginary part each; any constant where it is to be estimated.
    """
    amplitude = np.asarray(values, complex)
    amplitude = amplitude[:, :, None] if amplitude.ndim == 2 else amplitude
    wide = np.broadcast_to(np.asarray(sd, float), amplitude.shape).copy()
    steps = len(frequency_hz)
    return ResponseSeries(
        np.asarray(frequency_hz, float), amplitude, wide, wide.copy(), np.ones(steps), np.zeros(steps)
    )
