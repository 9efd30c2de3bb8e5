"""A shear frame on a table, in numbers: modes from masses and stiffnesses, and envelopes with noise but no images.

Floors move along X; a target between two floors moves as its column bends. Modal damping is given. The numbers are
those of a laboratory frame with a first mode near 5.4 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from labdaemon.findings import ModalBasis, PhaseReference, ResponseSeries

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LEVELS_MM = (190.0, 380.0, 570.0, 760.0)


def _equal(value: float) -> tuple[float, ...]:
    return (value,) * len(LEVELS_MM)


@dataclass(frozen=True, slots=True)
class ShearStructure:
    """Masses and storey stiffnesses.

    Attributes
    ----------
    mass_kg, stiffness_n_m
        From the lowest floor up.
    damping
        ζ of each mode, in ascending frequency.
    columns_mm
        (x, y) of the columns that carry targets.
    per_column
        Targets on each.
    """

    mass_kg: tuple[float, ...] = field(default_factory=lambda: _equal(0.5))
    stiffness_n_m: tuple[float, ...] = field(default_factory=lambda: _equal(4770.0))
    damping: tuple[float, ...] = (0.012, 0.010, 0.010, 0.009)
    columns_mm: tuple[tuple[float, float], ...] = ((-150.0, -100.0), (150.0, -100.0))
    per_column: int = 12

    def with_stiffness(self, storey: int, factor: float) -> ShearStructure:
        """One storey's stiffness multiplied."""
        stiffness = tuple(k * (factor if i == storey else 1.0) for i, k in enumerate(self.stiffness_n_m))
        return replace(self, stiffness_n_m=stiffness)

    def scaled(self, stiffness: float = 1.0, mass: float = 1.0) -> ShearStructure:
        """All stiffnesses and all masses multiplied: another temperature, mass everywhere."""
        return replace(
            self,
            stiffness_n_m=tuple(stiffness * k for k in self.stiffness_n_m),
            mass_kg=tuple(mass * m for m in self.mass_kg),
        )

    def positions_mm(self) -> FloatArray:
        """(T, 3) of the targets."""
        heights = np.linspace(45.0, LEVELS_MM[-1] - 25.0, self.per_column)
        return np.array([(x, y, z) for x, y in self.columns_mm for z in heights])

    def modes(self) -> tuple[FloatArray, FloatArray]:
        """Natural frequencies (M,), Hz, and floor displacements (floors, M) times participation factors."""
        k = np.array([*self.stiffness_n_m, 0.0])
        stiffness = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
        mass = np.diag(self.mass_kg)
        squares, vectors = eigh(stiffness, mass)
        return np.sqrt(squares) / (2 * np.pi), vectors * (vectors.T @ mass.sum(axis=1))[None, :]

    def residues(self) -> FloatArray:
        """(T, 3, M) residue of each mode at each target: the same along X, nothing across."""
        _, floors = self.modes()
        levels = np.array([0.0, *LEVELS_MM])
        displaced = np.vstack([np.zeros(floors.shape[1]), floors])
        height = self.positions_mm()[:, 2]
        above = np.clip(np.searchsorted(levels, height), 1, len(levels) - 1)
        share = np.clip((height - levels[above - 1]) / (levels[above] - levels[above - 1]), 0.0, 1.0)
        share = share**2 * (3 - 2 * share)  # a column clamped in both floors
        result = np.zeros((len(height), 3, floors.shape[1]))
        result[:, 0] = displaced[above - 1] * (1 - share)[:, None] + displaced[above] * share[:, None]
        return result

    def response(self, frequency_hz: FloatArray) -> ComplexArray:
        """(K, T, 3) motion per unit of the table's amplitude."""
        natural, _ = self.modes()
        columns = ModalBasis(residual_terms=1).columns(frequency_hz, natural, np.array(self.damping))
        residues = self.residues()
        constant = np.zeros((*residues.shape[:2], 1))
        constant[:, 0] = 1.0
        result: ComplexArray = np.einsum("kb,tdb->ktd", columns, np.concatenate([constant, residues], axis=2))
        return result


@dataclass(frozen=True, slots=True)
class Instrument:
    """What measures the structure.

    Attributes
    ----------
    sd_mm
        Of each component of an envelope.
    sd_table
        Relative, of the table's amplitude at each step.
    largest_mm
        Motion that the table's amplitude is chosen not to exceed.
    table_mm
        Its largest amplitude.
    phase
        What phases refer to.
    """

    sd_mm: float = 0.005
    sd_table: float = 0.002
    largest_mm: float = 6.0
    table_mm: float = 2.0
    phase: PhaseReference = PhaseReference.TARGET

    def table_at(self, response: ComplexArray) -> FloatArray:
        """(K,) amplitude of the table, mm, for a response (K, T, D) per millimetre of it."""
        result: FloatArray = np.minimum(self.table_mm, self.largest_mm / np.abs(response).max(axis=(1, 2)))
        return result

    def measure(
        self, structure: ShearStructure, frequency_hz: FloatArray, rng: np.random.Generator, level: float = 1.0
    ) -> ResponseSeries:
        """Envelopes at these frequencies, with noise and an error of the table's amplitude.

        Parameters
        ----------
        level
            Factor of the table's amplitude.
        """
        frequency = np.asarray(frequency_hz, float)
        response = structure.response(frequency)
        table = level * self.table_at(response)
        true = table * (1 + self.sd_table * rng.normal(size=len(frequency)))
        noise = rng.normal(size=(2, *response.shape)) * self.sd_mm
        amplitude = response * true[:, None, None] + noise[0] + 1j * noise[1]
        if self.phase is PhaseReference.STEP:
            amplitude = amplitude * np.exp(2j * np.pi * rng.uniform(size=len(frequency)))[:, None, None]
        if self.phase is PhaseReference.TARGET:
            turn = 0.5 * np.angle(np.sum(amplitude**2, axis=2, keepdims=True))
            amplitude = amplitude * np.exp(-1j * turn)
        sd = np.full(response.shape, self.sd_mm)
        return ResponseSeries(frequency, amplitude, sd, sd, table, np.full(len(frequency), self.sd_table), self.phase)
