"""Coded light: a lamp whose brightness follows the excitation, so that one exposure holds amplitude and phase.

Let w(θ) be the brightness of the lamp over the excitation's phase θ. Over whole cycles of the code the image of a
target that moves as d(θ) = a sin θ + b cos θ is its sharp image, convolved with the point spread function of which the
transform is

    H(f) = ∫ w(θ) exp(−2πi f·d(θ)) dθ / ∫ w(θ) dθ .

Constant light, w = 1, gives J0 and hides the phase. Any other w weighs the path unevenly, and the image shows where the
target was when the lamp was bright. The opening and the length of the shutter play no part, as long as whole cycles of
the code lie inside the exposure.

Ambient light is on as long as the shutter is open. It adds the point spread function of constant light, in proportion
to its share of all light.

Codes have **twins**. A code that is its own mirror image, w(θ₀ + τ) = w(θ₀ − τ), shows a motion and the same motion run
backwards from θ₀ as one image. Several captures whose codes have no common axis tell them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.quadrature import gauss_legendre
from labdaemon.errors import UsageError

NAMED_SECTORS = 64
"""Sectors by which a cosine or sine is sampled."""

EVEN_TOLERANCE = 1e-6
"""Difference of brightness below which neighbouring sectors are one, and a code shows no phase."""

MANY_RUNS = 16
"""Runs of equal sectors above which a code is integrated by its harmonics: sector by sector takes several times as many
nodes."""

MIN_RISE_RAD = 1e-9
"""Rise time below which the lamp switches at once."""

AXIS_SEPARATION = 0.15
"""Sine of the angle between two axes of a code below which they are one."""

_FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True, slots=True)
class LightCode:
    """Brightness of the lamp over the excitation's cycle.

    Attributes
    ----------
    brightness
        In equal sectors of one cycle, 0 to 1 in parts of the lamp's full brightness.
    phase_rad
        Excitation phase at which the first sector begins.
    cycles
        Whole cycles of the code inside the open shutter.
    ambient
        Light that is on whenever the shutter is open, in parts of the lamp's full brightness.
    rise_rad
        Time that the lamp takes from dark to full brightness and back, as excitation phase. The brightness changes
        linearly meanwhile, beginning at the edge of the sector.
    sd_phase_rad, sd_ambient
        Standard deviations of phase and ambient light.
    is_phase_known
        False where the phase was not recorded: `phase_rad` is then any, and only the axes of a motion are known.

    Raises
    ------
    UsageError
        Fewer than two sectors, a brightness outside 0 to 1, a lamp that is never on, or numbers out of range.
    """

    brightness: tuple[float, ...]
    phase_rad: float = 0.0
    cycles: int = 1
    ambient: float = 0.0
    rise_rad: float = 0.0
    sd_phase_rad: float = 0.0
    sd_ambient: float = 0.0
    is_phase_known: bool = True

    def __post_init__(self) -> None:
        values = np.asarray(self.brightness, dtype=np.float64)
        if values.size < 2 or not np.all(np.isfinite(values)) or values.min() < 0 or values.max() > 1:
            raise UsageError("light is a list of two or more brightnesses from 0 to 1, one for each equal sector")
        if values.max() <= 0:
            raise UsageError("light is zero in every sector: the lamp is never on")
        if self.cycles < 1:
            raise UsageError("light_cycles is a whole number of cycles, at least 1")
        if not np.isfinite(self.phase_rad) or not 0 <= self.ambient < np.inf:
            raise UsageError("light_phase_rad must be finite and ambient must not be negative")
        if not 0 <= self.rise_rad <= _FULL_TURN / values.size:
            raise UsageError("the lamp's rise time must not be longer than one sector of the code")

    @property
    def shows_phase(self) -> bool:
        """Whether the brightness varies at all."""
        return max(self.brightness) - min(self.brightness) > EVEN_TOLERANCE

    def at(self, phase_rad: FloatArray) -> FloatArray:
        """Brightness of the lamp at excitation phases, any shape, rise time included."""
        values = np.asarray(self.brightness, dtype=np.float64)
        sector = _FULL_TURN / values.size
        place = np.mod(np.asarray(phase_rad, dtype=np.float64) - self.phase_rad, _FULL_TURN)
        index = np.minimum((place / sector).astype(int), values.size - 1)
        now, before = values[index], values[index - 1]
        if self.rise_rad < MIN_RISE_RAD:
            return np.asarray(now)
        risen = np.clip((place - index * sector) / self.rise_rad, 0.0, 1.0)
        result: FloatArray = before + (now - before) * risen
        return result

    def lamp_nodes(self, max_amplitude_px: float) -> tuple[FloatArray, FloatArray]:
        """Phases of one cycle and weights whose sum is the mean brightness of the lamp.

        Parameters
        ----------
        max_amplitude_px
            Largest amplitude to be represented.
        """
        values = np.asarray(self.brightness, dtype=np.float64)
        if len(_equal_runs(values)) > MANY_RUNS:
            return self._harmonic_nodes(max_amplitude_px)
        sector = _FULL_TURN / values.size
        angles: list[FloatArray] = []
        weights: list[FloatArray] = []

        def add(begin: float, end: float, first: float, last: float) -> None:
            if max(first, last) <= 0 or end <= begin:
                return
            count = 6 + int(np.ceil((2.5 + 0.8 * max_amplitude_px) * (end - begin)))
            x, w = gauss_legendre(count)
            part = (x + 1) / 2
            angles.append(self.phase_rad + begin + (end - begin) * part)
            weights.append(w / 2 * (end - begin) / _FULL_TURN * (first + (last - first) * part))

        for first, last in _equal_runs(values):
            begin, level, before = first * sector, float(values[first]), float(values[first - 1])
            rise = self.rise_rad if abs(level - before) > EVEN_TOLERANCE and self.rise_rad >= MIN_RISE_RAD else 0.0
            add(begin, begin + rise, before, level)
            add(begin + rise, last * sector, level, level)
        return np.concatenate(angles), np.concatenate(weights)

    def _harmonic_nodes(self, max_amplitude_px: float) -> tuple[FloatArray, FloatArray]:
        """Nodes for codes of many sectors, by the harmonics of the brightness that a motion shows.

        The image of a motion of A px holds Bessel functions of arguments up to πA, which vanish beyond that order. So
        the brightness counts up to harmonic N = πA and a few more, and 2N evenly spaced phases integrate it exactly.
        """
        values = np.asarray(self.brightness, dtype=np.float64)
        highest = int(np.ceil(np.pi * max_amplitude_px)) + 12
        count = 2 * highest + 2
        order = np.arange(-highest, highest + 1)
        sector = _FULL_TURN / values.size
        # Fourier coefficients of the sectors; the rise is a mean over the time that it takes.
        coefficients = np.fft.fft(values)[order % values.size] / values.size
        coefficients = coefficients * np.exp(-0.5j * order * (sector + self.rise_rad))
        coefficients = coefficients * np.sinc(order * sector / _FULL_TURN) * np.sinc(order * self.rise_rad / _FULL_TURN)
        place = np.arange(count) * _FULL_TURN / count
        weights = np.real(np.exp(1j * place[:, None] * order) @ coefficients) / count
        return self.phase_rad + place, weights


def named_code(name: str | Sequence[float]) -> tuple[float, ...]:
    """Brightness of a code by its name: bits as ``"1110100"``, ``"cos"``, ``"sin"``, or a list of numbers as it is.

    ``"cos"`` and ``"sin"`` are (1 + cos θ)/2 and (1 + sin θ)/2, sampled in the middle of 64 sectors.

    Raises
    ------
    UsageError
        Neither bits nor a known name.
    """
    if not isinstance(name, str):
        return tuple(float(value) for value in name)
    middle = (np.arange(NAMED_SECTORS) + 0.5) * _FULL_TURN / NAMED_SECTORS
    if name == "cos":
        return tuple(float(value) for value in (1 + np.cos(middle)) / 2)
    if name == "sin":
        return tuple(float(value) for value in (1 + np.sin(middle)) / 2)
    if name and not set(name) - {"0", "1"}:
        return tuple(float(bit) for bit in name)
    raise UsageError(f"light {name!r} is no code: write bits as 1110100, cos or sin, or a list of brightnesses")


def mirror_axes(code: LightCode, *, least_likeness: float = 0.99) -> list[float]:
    """Excitation phases about which a code resembles its own mirror image, most similar first, within half a turn.

    Parameters
    ----------
    least_likeness
        Correlation of the code with its mirror image; 1 is a code with an exact twin.
    """
    count = max(8 * len(code.brightness), 512)
    theta = np.arange(count) * _FULL_TURN / count
    values = code.at(theta)
    spread = float(np.std(values))
    if spread <= EVEN_TOLERANCE:
        return [0.0]
    # The correlation of a code with its own reversal, over all axes at once.
    spectrum = np.fft.fft(values - values.mean())
    likeness = np.real(np.fft.ifft(spectrum * spectrum)) / (count * spread**2)
    axes: list[float] = []
    for place in np.argsort(-likeness):
        axis = float(np.mod(theta[place] / 2, np.pi))
        if likeness[place] <= least_likeness:
            break
        if all(abs(np.sin(axis - other)) > AXIS_SEPARATION for other in axes):
            axes.append(axis)
    return axes


def _equal_runs(values: FloatArray) -> list[tuple[int, int]]:
    """Runs of sectors of one brightness as (first, after last), without going round the end."""
    edges = np.flatnonzero(np.abs(np.diff(values)) > EVEN_TOLERANCE) + 1
    bounds = [0, *(int(edge) for edge in edges), values.size]
    return list(pairwise(bounds))
