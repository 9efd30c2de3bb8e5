"""The threshold effect: how far a phase may be off where its likelihood is no parabola.

The Cramér–Rao bound (``prediction``) is the curvature of the likelihood at the true motion. At a few pixels and less
the images of a motion and of another one, a good part of a radian away, differ by a few standard deviations only: the
likelihood has shelves and second minima, and the error of any estimate leaves the bound (Rife and Boorstyn 1974,
doi:10.1109/TIT.1974.1055282). What an estimate then errs by is what the likelihood as a whole leaves open.

Here the likelihood is computed over all phases for draws of the noise. Images are their transfer functions along the
motion, as in ``twins``; for each phase the amplitude and what each frame has of its own are adjusted. The noise is
scaled so that the curvature is that of the bound, which knows the paper texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.prediction import DotImage
from labdaemon.blur.settings import PHASE
from labdaemon.blur.twins import TransferTable

PHASES = 360
"""Phases over which the likelihood is summed."""
DRAWS = 8
"""Draws of the noise for each motion."""
_STEP = 0.02
"""Relative step of the amplitude for its derivative. Numerics."""


@dataclass(frozen=True, slots=True, eq=False)
class PhaseScatter:
    """What images of motions leave open, root mean square over the noise.

    Attributes
    ----------
    phase_rad, amplitude_px
        (n,) scatter of the phase and the amplitude over the likelihood of the phases in one valley.
    ambiguous
        (n,) share of images that do not exclude another valley. They are flagged `ambiguous`, and are not in the
        scatter.
    """

    phase_rad: FloatArray
    amplitude_px: FloatArray
    ambiguous: FloatArray


def predict_scatter(
    exposures: Sequence[ExposureWindow],
    amplitude_px: float,
    phases_rad: FloatArray,
    bound_rad: FloatArray,
    dot: DotImage,
    *,
    draws: int = DRAWS,
) -> PhaseScatter:
    """Predict the scatter of phase and amplitude by the whole likelihood.

    Parameters
    ----------
    exposures, amplitude_px, dot
        As for `predict_sd`.
    phases_rad, bound_rad
        (n,) phases of the motion, and the Cramér–Rao bound of each.
    draws
        Of the noise for each phase; they are the same for every call.
    """
    # Where the phase hardly shows the fits sum up all of them, and there are no valleys (`phase.posterior`).
    is_narrow = float(np.sqrt(np.mean(bound_rad**2))) < PHASE.linear_phase_sd_rad
    curve = _LikelihoodCurve(exposures, amplitude_px, dot, LIGHT.same_valley_rad if is_narrow else np.pi)
    rng = np.random.default_rng(0)
    rows = [
        curve.scatter(float(phase), float(bound), rng.normal(size=(draws, curve.size)))
        for phase, bound in zip(phases_rad, bound_rad, strict=True)
    ]
    return PhaseScatter(*np.array(rows).T)


class _LikelihoodCurve:
    """Whitened images of the motions of all phases, with their derivatives by what is adjusted."""

    def __init__(
        self, exposures: Sequence[ExposureWindow], amplitude_px: float, dot: DotImage, valley_rad: float
    ) -> None:
        self._valley_rad = valley_rad
        table = TransferTable(exposures, amplitude_px, dot)
        self._phases = np.arange(PHASES) / PHASES * 2 * np.pi
        sizes = amplitude_px * np.array([1 - _STEP, 1.0, 1 + _STEP])
        below, here, above = (table.transfers(np.stack((self._phases, np.full(PHASES, one)))) for one in sizes)
        count = len(exposures)
        images, columns = [], []
        for index, weight in enumerate(table.weights):
            root, f, own = np.sqrt(weight), table.frequencies, here[index]
            moves = np.zeros((2 * count + 1, PHASES, len(f)), complex)
            moves[0] = (above[index] - below[index]) / (2 * _STEP * amplitude_px)
            moves[2 * index + 1] = -2j * np.pi * f * own
            moves[2 * index + 2] = -2 * np.pi**2 * f**2 * own
            images.append(_real(own * root))
            columns.append(_real(moves * root))
        self._images: FloatArray = np.concatenate(images, axis=-1)
        self._columns: FloatArray = np.concatenate(columns, axis=-1)
        normal = np.einsum("ipf,jpf->pij", self._columns, self._columns)
        prior = np.array([0.0, *[1e-6, dot.sd_defocus_px2**-2] * count])
        self._inverse = np.linalg.inv(normal + np.diag(prior) + 1e-9 * np.eye(2 * count + 1))
        self.size: int = self._images.shape[1]

    def scatter(self, phase_rad: float, bound_rad: float, noise: FloatArray) -> tuple[float, float, float]:
        """Scatter of phase (rad) and amplitude (px) in the valley, and the share of ambiguous images."""
        true = round(phase_rad / (2 * np.pi) * PHASES) % PHASES
        step = 2 * np.pi / PHASES
        near = self._adjust(self._images[true][None])[0][0, [true - 1, (true + 1) % PHASES]]
        scale = 1 / (max(float(near.mean()), 1e-300) / step**2 * bound_rad**2)
        cost, amplitude = self._adjust(self._images[true] + noise / np.sqrt(scale))
        cost = scale * (cost - cost.min(axis=1, keepdims=True))
        best = np.argmin(cost, axis=1)
        away = np.angle(np.exp(1j * (self._phases - self._phases[best][:, None])))
        valley = np.abs(away) <= self._valley_rad
        minima = (cost <= np.roll(cost, 1, axis=1)) & (cost <= np.roll(cost, -1, axis=1)) & ~valley
        ambiguous = np.any(minima & (cost < PHASE.rival_cost), axis=1)
        probability = np.where(valley, np.exp(-cost / 2), 0.0)
        probability /= probability.sum(axis=1, keepdims=True)
        sharp = ~ambiguous if not ambiguous.all() else ambiguous
        amplitude = amplitude - np.take_along_axis(amplitude, best[:, None], axis=1)
        phase2, amplitude2 = (float(np.mean(np.sum(probability * one**2, axis=1)[sharp])) for one in (away, amplitude))
        phase2 = max(phase2 - step**2 / 12, 0.0)  # the best phase of the grid is not the best of all
        return float(np.sqrt(phase2)), float(np.sqrt(amplitude2)), float(ambiguous.mean())

    def _adjust(self, images: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, phases) squared distance from images (n, size) after adjustment, and the amplitude's correction."""
        left = images[:, None, :] - self._images
        pull = np.einsum("npf,ipf->npi", left, self._columns, optimize=True)
        found = np.einsum("pij,npj->npi", self._inverse, pull)
        return np.einsum("npf,npf->np", left, left) - np.sum(pull * found, axis=2), found[:, :, 0]


def _real(values: np.ndarray) -> FloatArray:
    return np.concatenate((values.real, values.imag), axis=-1)
