"""Displacement over the exposure as nodes in time, for whatever is not a sinusoid over whole cycles.

A blur is the mean over time of the displaced image, so any motion is a sum over instants t_k with weights w_k:
H(f) = Σ w_k exp(−2πi f·d(t_k)), d(t_k) = Σ_j v_j B_j(t_k), with the vectors v_j to be fitted and known functions B_j.
The exponential factors into x and y, so the sum is a product of two small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.quadrature import gauss_legendre
from labdaemon.errors import UsageError


@dataclass(frozen=True, slots=True, eq=False)
class MotionWaveform:
    """A declared course of the displacement over the exposure; the fit finds the vector that multiplies it.

    Attributes
    ----------
    displacement
        (K,) dimensionless, mean over the exposure 0; its largest excursion, half peak to peak, is 1.
    weight
        (K,) part of the exposure spent there; sums to 1.
    """

    displacement: FloatArray
    weight: FloatArray

    @staticmethod
    def _from_samples(values: FloatArray, weight: FloatArray) -> MotionWaveform:
        max_amplitude = float(np.ptp(values)) / 2
        if not np.all(np.isfinite(values)) or max_amplitude <= 0:
            raise UsageError("a displacement law must be finite and must move; check the record")
        values = values / max_amplitude
        return MotionWaveform(values - float(weight @ values), weight)

    @classmethod
    def harmonics(cls, amplitudes: Sequence[float], phases_rad: Sequence[float], *, nodes: int = 512) -> MotionWaveform:
        """Σ_n A_n sin(nωt + φ_n) over whole cycles, n = 1, 2, 3 …

        Raises
        ------
        UsageError
            No amplitude, or not one phase for each.
        """
        if not amplitudes or len(amplitudes) != len(phases_rad):
            raise UsageError("give one phase for each harmonic's amplitude")
        angle = 2 * np.pi * (np.arange(nodes) + 0.5) / nodes
        values = np.zeros(nodes)
        for order, (amplitude, phase) in enumerate(zip(amplitudes, phases_rad, strict=True), start=1):
            values += amplitude * np.sin(order * angle + phase)
        return cls._from_samples(values, np.full(nodes, 1 / nodes))

    @classmethod
    def triangular(cls, *, nodes: int = 256) -> MotionWaveform:
        """Constant speed to and fro: every place between the ends equally long (Gauss–Legendre nodes)."""
        values, weight = gauss_legendre(nodes)
        return cls(values, weight / 2)

    @classmethod
    def record(cls, values: Sequence[float] | FloatArray) -> MotionWaveform:
        """A gauge's record over the exposure: equally spaced samples, any unit.

        Raises
        ------
        UsageError
            Fewer than eight samples, or no motion in them.
        """
        samples = np.asarray(values, dtype=np.float64)
        if samples.ndim != 1 or samples.size < 8:
            raise UsageError("a gauge's record needs at least eight samples over the exposure")
        return cls._from_samples(samples, np.full(samples.size, 1 / samples.size))


@lru_cache(maxsize=64)
def window_nodes(window: ExposureWindow, max_amplitude_px: float) -> tuple[FloatArray, FloatArray]:
    """Sin ωt and cos ωt at the nodes of an exposure, each with its harmonics if there are any, and the nodes' weights.

    Whole cycles are evenly spaced nodes, the rest is Gauss–Legendre from the opening phase on. Coded light has its own
    nodes, sector by sector; ambient light adds those of the exposure, in proportion to its share of all light.

    Parameters
    ----------
    window
        Its phase None counts as 0.
    max_amplitude_px
        Largest amplitude to be represented; the nodes must resolve π·reach radians of phase.

    Returns
    -------
    basis, weight
        (2, K) sin and cos; (K,). Fits ask for the same ones many times: they are kept, and must not be changed.
    """
    if window.light is None:
        angle, weight = _exposure_nodes(window, _bandwidth(window) * max_amplitude_px)
        return _kept(_basis(window, angle), weight)
    parts = light_parts(window, max_amplitude_px)
    ambient = window.light.ambient * parts.room_cycles
    (basis, weight), (room_basis, room_weight) = parts.lamp, parts.room
    if ambient == 0:
        return basis, weight
    total = parts.lamp_cycles + ambient
    weights = np.concatenate((weight * parts.lamp_cycles, room_weight * ambient)) / total
    return _kept(np.concatenate((basis, room_basis), axis=1), weights)


@dataclass(frozen=True, slots=True, eq=False)
class LightParts:
    """Nodes of the lamp's light and of the room's in an exposure.

    Attributes
    ----------
    lamp, room
        Sin ωt and cos ωt (2, K), and weights (K,) whose sum is 1.
    lamp_cycles, room_cycles
        Light of each in cycles of full brightness, the room's for ambient light 1: it lasts as long as the shutter is
        open.
    """

    lamp: tuple[FloatArray, FloatArray]
    room: tuple[FloatArray, FloatArray]
    lamp_cycles: float
    room_cycles: float


@lru_cache(maxsize=64)
def light_parts(window: ExposureWindow, max_amplitude_px: float) -> LightParts:
    """The lamp's and the room's part of coded light; parameters as for `window_nodes`.

    Raises
    ------
    UsageError
        The window has constant light.
    """
    if window.light is None:
        raise UsageError("constant light has no lamp that follows the excitation")
    max_amplitude_px *= _bandwidth(window)
    angle, weight = _exposure_nodes(window, max_amplitude_px)
    lamp_angle, lamp_weight = window.light.lamp_nodes(max_amplitude_px)
    mean = float(lamp_weight.sum())
    return LightParts(
        _kept(_basis(window, lamp_angle), lamp_weight / mean),
        _kept(_basis(window, angle), weight),
        mean * window.light.cycles,
        window.cycles,
    )


def _kept(basis: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes that many fits share: writing to them is an error."""
    basis.setflags(write=False)
    weight.setflags(write=False)
    return basis, weight


def _bandwidth(window: ExposureWindow) -> float:
    """How much finer than of a sinusoid the nodes must be."""
    return 1.0 if window.harmonics is None else window.harmonics.bandwidth


def _basis(window: ExposureWindow, angle: FloatArray) -> FloatArray:
    """Sin ωt and cos ωt (2, K) at phases, each with its harmonics if there are any."""
    return np.stack((np.sin(angle), np.cos(angle))) if window.harmonics is None else window.harmonics.basis(angle)


def _exposure_nodes(window: ExposureWindow, max_amplitude_px: float) -> tuple[FloatArray, FloatArray]:
    """Phases and weights of constant light over the exposure; under coded light of unknown opening, whole cycles."""
    cycles = window.cycles
    if window.light is not None and window.phase_rad is None:
        cycles = float(max(round(cycles), 1))
    phase = window.phase_rad if window.phase_rad is not None else 0.0
    whole = int(np.floor(cycles + 1e-9))
    rest = max(cycles - whole, 0.0)
    angles: list[FloatArray] = []
    weights: list[FloatArray] = []
    if whole:
        count = 24 + int(4.5 * max_amplitude_px)
        angles.append(phase + 2 * np.pi * np.arange(count) / count)
        weights.append(np.full(count, whole / cycles / count))
    if rest > 1e-6:
        nodes, weight = gauss_legendre(16 + int(3.5 * max_amplitude_px * min(1.0, 0.3 + rest)))
        angles.append(phase + np.pi * rest * (nodes + 1))
        weights.append(weight / 2 * rest / cycles)
    return np.concatenate(angles), np.concatenate(weights)


def quadrature_transfer(
    fx: FloatArray, fy: FloatArray, vectors: FloatArray, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Transfer function Σ w_k exp(−2πi f·d_k) and its derivatives.

    Parameters
    ----------
    fx, fy
        (rows, columns) of a grid: fx depends on the column only, fy on the row only.
    vectors
        (2J,) x and y of each fitted vector.
    basis, weight
        (J, K) and (K,).

    Returns
    -------
    transfer, derivatives
        (rows, columns) and (2J, rows, columns).
    """
    pairs = vectors.reshape(-1, 2)
    path = pairs.T @ basis
    moments = _moments(fx, fy, path, np.concatenate((np.ones((1, basis.shape[1])), basis)), weight)
    derivatives = np.empty((2 * len(pairs), *fx.shape), dtype=moments.dtype)
    np.multiply(moments[1:], fx, out=derivatives[0::2])
    np.multiply(moments[1:], fy, out=derivatives[1::2])
    derivatives *= moments.dtype.type(-2j * np.pi)
    return moments[0], derivatives


def _moments(fx: FloatArray, fy: FloatArray, path: FloatArray, factors: FloatArray, weight: FloatArray) -> ComplexArray:
    """Sums Σ w_k g_k exp(−2πi f·d_k) over an exposure, in the precision of the grid.

    Parameters
    ----------
    path, factors, weight
        (2, K) displacement d, (n, K) factors g, (K,).

    Returns
    -------
    (n, rows, columns)
    """
    single = fx.dtype == np.float32
    along_x, along_y = (
        _turn((-2 * np.pi * place)[:, None] * frequency, single=single)
        for place, frequency in zip(path, (fx[0].astype(np.float64), fy[:, 0].astype(np.float64)), strict=True)
    )
    weighted = (factors * weight).astype(along_y.real.dtype)[:, None, :] * along_y.T
    # One product for all: small ones leave the processor waiting.
    moments: ComplexArray = (weighted.reshape(-1, len(weight)) @ along_x).reshape(len(factors), *fx.shape)
    return moments


def _turn(angle: FloatArray, *, single: bool) -> ComplexArray:
    """Exp(i·angle); the angle itself needs both words, long paths turn many times."""
    if not single:
        exact: ComplexArray = np.exp(1j * angle)
        return exact
    whole = (angle - 2 * np.pi * np.rint(angle / (2 * np.pi))).astype(np.float32)
    result: Any = np.empty(angle.shape, dtype=np.complex64)
    np.cos(whole, out=result.real)
    np.sin(whole, out=result.imag)
    return cast(ComplexArray, result)


def in_phase_transfer(
    fx: FloatArray, fy: FloatArray, motion: FloatArray, basis: FloatArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Transfer function of an in-phase motion v·sin(ωt + ψ) at nodes, and its derivatives by vx, vy and ψ.

    Parameters
    ----------
    fx, fy
        As for `quadrature_transfer`.
    motion
        (3,) vx, vy (px) and ψ (rad).
    basis, weight
        (2, K) sin ωt and cos ωt; (K,).
    """
    turn = np.array([[np.cos(motion[2]), np.sin(motion[2])], [-np.sin(motion[2]), np.cos(motion[2])]])
    waveform = turn @ basis
    path = motion[:2, None] * waveform[0]
    still, moment, later = _moments(fx, fy, path, np.stack((np.ones_like(weight), *waveform)), weight)
    slopes = np.stack((fx * moment, fy * moment, (motion[0] * fx + motion[1] * fy).astype(fx.dtype) * later))
    slopes *= slopes.dtype.type(-2j * np.pi)
    return still, slopes
