"""Twins of a group of captures: another motion of different phase that leaves nearly the same images.

The curvature at the solution says nothing of them, so they are searched for over all phases and amplitudes. For motions
along one direction, the images of A·sin(ωt + ψ) and A'·sin(ωt + ψ') differ by

    D² = Σ ∫ Q(f) |H(f) − H'(f)|² df ,

summed over the captures, with f along the motion, H the transfer functions, and Q the dot's spectrum over the noise,
integrated across the motion. What a fit would adjust (position, contrast, defocus of each frame) is adjusted. D is the
distance in standard deviations: with one at D, the wrong one is taken with the probability Φ(−D/2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.prediction import DEFOCUS_SD_PX2, DotImage, light_fraction
from labdaemon.blur.spectra.closed_form import diffraction_transfer, ellipse_spectrum, gaussian_transfer, pixel_transfer
from labdaemon.blur.waveform import window_nodes
from labdaemon.errors import UsageError

APART_RAD = np.pi / 6
"""Motions whose phases are nearer than this are one solution, not two."""

_FREQUENCIES = 40
_MOST_NODES = 120
_GRID_PHASES = 72
_GRID_AMPLITUDES = np.geomspace(0.7, 1.4, 15)
_ROUNDS = 7
"""Of refinement; each halves the steps of the grid."""


@dataclass(frozen=True, slots=True)
class Twin:
    """The motion that is hardest to tell from another one.

    Attributes
    ----------
    distance_sd
        Distance D between the two in standard deviations of one target's image; 0 for an exact twin.
    phase_rad
        Phase of the motion, the worst of those that were tried.
    twin_phase_rad, twin_amplitude_px
        The motion that it is taken for.
    """

    distance_sd: float
    phase_rad: float
    twin_phase_rad: float
    twin_amplitude_px: float


def nearest_twin(
    exposures: Sequence[ExposureWindow], amplitude_px: float, dot: DotImage | None = None, *, phases: int = 8
) -> Twin:
    """Search the nearest twin of a group of captures, over all phases and amplitudes.

    Parameters
    ----------
    exposures
        Windows of the group's captures, with their light.
    amplitude_px
        Semi-amplitude in the image for which it is searched.
    dot
        The dot's image, see `labdaemon.blur.predict_sd`.
    phases
        How many phases of the motion are tried, over half a turn: a motion and its opposite have the same twins.

    Returns
    -------
    Twin
        For the worst of these phases.

    Raises
    ------
    UsageError
        No exposure, or an amplitude that is not positive.
    """
    if not exposures or not 0 < amplitude_px < np.inf:
        raise UsageError("a search for twins needs an exposure, and an amplitude above zero")
    group = TransferTable(exposures, amplitude_px, dot or DotImage())
    # Off the grid's own multiples, where symmetric codes have motions that are their own twins.
    tried = (np.arange(phases) + 0.37) / phases * np.pi
    return min((group.nearest(float(phase)) for phase in tried), key=lambda twin: twin.distance_sd)


class TransferTable:
    """Transfer functions of a group's captures along the motion, and how far apart the images of two motions are."""

    def __init__(self, exposures: Sequence[ExposureWindow], amplitude_px: float, dot: DotImage) -> None:
        self._amplitude_px = amplitude_px
        self.frequencies: FloatArray = (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES * _band(dot)
        self._nodes = [_few_nodes(*window_nodes(window, 1.5 * amplitude_px)) for window in exposures]
        self.weights: list[FloatArray] = [
            _spectral_weight(self.frequencies, dot, light_fraction(window)) for window in exposures
        ]
        turns = np.arange(_GRID_PHASES) / _GRID_PHASES * 2 * np.pi
        phase, amplitude = np.meshgrid(turns, amplitude_px * _GRID_AMPLITUDES, indexing="ij")
        self._grid = np.stack((phase.ravel(), amplitude.ravel()))
        self._grid_transfers = self.transfers(self._grid)

    def nearest(self, phase_rad: float) -> Twin:
        """The nearest twin of one motion."""
        own = self.transfers(np.array([[phase_rad], [self._amplitude_px]]))
        far = _apart(self._grid[0], phase_rad)
        distance = np.where(far, self._distance2(own, self._grid_transfers), np.inf)
        best, found = np.inf, self._grid[:, 0]
        for start in _minima(distance.reshape(_GRID_PHASES, -1)):
            value, motion = self._refine(own, phase_rad, self._grid[:, start])
            if value < best:
                best, found = value, motion
        return Twin(float(np.sqrt(best)), phase_rad, float(found[0] % (2 * np.pi)), float(found[1]))

    def _refine(self, own: list[ComplexArray], phase_rad: float, start: FloatArray) -> tuple[float, FloatArray]:
        """Best motion near a point of the grid, by a grid about it that shrinks."""
        place, best = start, np.inf
        steps = np.array([2 * np.pi / _GRID_PHASES, 0.05 * self._amplitude_px])
        offsets = np.stack([part.ravel() for part in np.meshgrid(*2 * [np.linspace(-1, 1, 5)], indexing="ij")])
        for _ in range(_ROUNDS):
            around = place[:, None] + offsets * steps[:, None]
            distance = np.where(_apart(around[0], phase_rad), self._distance2(own, self.transfers(around)), np.inf)
            least = int(np.argmin(distance))
            if distance[least] < best:
                best, place = float(distance[least]), around[:, least]
            steps = steps / 2
        return best, place

    def transfers(self, motions: FloatArray) -> list[ComplexArray]:
        """Transfer functions (motions, frequencies) of each capture, about the path's centroid."""
        found: list[ComplexArray] = []
        for basis, weight in self._nodes:
            path = motions[1][:, None] * (
                np.cos(motions[0])[:, None] * basis[0] + np.sin(motions[0])[:, None] * basis[1]
            )
            path = path - (path @ weight)[:, None]
            # Frequencies are equally spaced, so that each power of the exponential is the one before times a step.
            step = np.exp(-2j * np.pi * (self.frequencies[1] - self.frequencies[0]) * path)
            power = np.exp(-2j * np.pi * self.frequencies[0] * path) * weight
            columns = [power.sum(axis=1)]
            for _ in self.frequencies[1:]:
                power = power * step
                columns.append(power.sum(axis=1))
            found.append(np.stack(columns, axis=1))
        return found

    def _distance2(self, own: list[ComplexArray], others: list[ComplexArray]) -> FloatArray:
        """D² (motions,) between one motion and others, with each frame's own unknowns adjusted."""
        total = np.zeros(len(others[0]))
        prior = np.diag([1e-6, 1e-6, DEFOCUS_SD_PX2**-2])
        for one, other, weight in zip(own, others, self.weights, strict=True):
            left = one - other
            moves = np.stack(
                (-2j * np.pi * self.frequencies * other, other, -2 * np.pi**2 * self.frequencies**2 * other), axis=1
            )
            normal = np.einsum("mif,mjf,f->mij", moves.conj(), moves, weight).real + prior
            pull = np.einsum("mif,mf,f->mi", moves.conj(), left, weight).real
            gain = np.einsum("mi,mi->m", pull, np.linalg.solve(normal, pull[:, :, None])[:, :, 0])
            total += np.maximum(np.abs(left) ** 2 @ weight - gain, 0.0)
        return total


def _few_nodes(basis: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same light at fewer phases, where a code has many sectors: each cell of phase at its own mean."""
    if weight.size <= _MOST_NODES:
        return basis, weight
    cell = np.floor(np.mod(np.arctan2(basis[0], basis[1]), 2 * np.pi) / (2 * np.pi) * _MOST_NODES).astype(int)
    total = np.bincount(cell, weight).astype(np.float64)
    lit = total > 0
    means = [np.bincount(cell, weight * row)[lit] / total[lit] for row in basis]
    return np.stack(means), total[lit]


def _band(dot: DotImage) -> float:
    """Frequency up to which the lens passes the dot, cycles a pixel."""
    return min(0.5, 0.45 / max(dot.lens_sigma_px, 0.5))


def _spectral_weight(f: FloatArray, dot: DotImage, light: float) -> FloatArray:
    """Q(f): the dot's squared spectrum over the noise, integrated across the motion, times the step in f and both
    signs.
    """
    across = np.linspace(-0.5, 0.5, 401)
    fx, fy = np.meshgrid(f, across, indexing="ij")
    square = fx**2 + fy**2
    dark = ellipse_spectrum(fx, fy, np.array([dot.radius_px, 0.0, dot.radius_px]))[0]
    dark = dark * gaussian_transfer(square, dot.lens_sigma_px**2) * pixel_transfer(fx, fy)
    if dot.diffraction_px > 0:
        dark = dark * diffraction_transfer(np.sqrt(square), dot.diffraction_px)
    white = dot.white_dn * light
    variance = dot.noise.variance(np.array(white * (1 + dot.ink) / 2))
    density = (1 - dot.ink) ** 2 * white**2 * dark**2 / variance
    weight: FloatArray = 2 * (f[1] - f[0]) * density.sum(axis=1) * (across[1] - across[0])
    return weight


def _apart(phases: FloatArray, phase_rad: float) -> FloatArray:
    """Whether phases are far enough from one to be other solutions."""
    away: FloatArray = np.abs(np.angle(np.exp(1j * (phases - phase_rad)))) >= APART_RAD - 1e-9
    return away


def _minima(distance: FloatArray, most: int = 3) -> list[int]:
    """Places, in the flat grid, of the smallest local minima over the phase (rows), each at its best amplitude."""
    best = distance.min(axis=1)
    low = (best <= np.roll(best, 1)) & (best <= np.roll(best, -1)) & np.isfinite(best)
    rows = np.flatnonzero(low)
    rows = rows[np.argsort(best[rows])][:most]
    return [int(row * distance.shape[1] + np.argmin(distance[row])) for row in rows]
