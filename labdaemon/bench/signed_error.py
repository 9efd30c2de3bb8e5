"""Errors of a measured signed motion and how they compare with what was stated, for benches.

Pulls are taken in the directions of the *measured* vectors, as a reader of the result would take them. A phase that is
a little off turns the vectors: in the true direction part of its large variance would count as the amplitude's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur import FloatArray, Measurement

RESAMPLES = 2000
"""Bootstrap samples of an interval."""


@dataclass(frozen=True, slots=True)
class SignedError:
    """What a measured motion is off by.

    Attributes
    ----------
    vector_px
        Length of the error of (a, b).
    amplitude_px, phase_rad
        Of the size sqrt(|a|² + |b|²), and of the common phase.
    sd_phase_rad
        Stated standard deviation of the phase.
    amplitude_pull, phase_pull
        Errors over stated standard deviations. The amplitude's are those of the axis where the phase hardly shows.
    """

    vector_px: float
    amplitude_px: float
    phase_rad: float
    sd_phase_rad: float
    amplitude_pull: float
    phase_pull: float


def signed_error(found: Measurement, true_px: FloatArray) -> SignedError:
    """Compare a phased measurement with the truth.

    Parameters
    ----------
    found
        With its phase.
    true_px
        (4,) ax, ay, bx, by.
    """
    seen = np.concatenate((found.a_px, found.b_px))
    size, true_size = float(np.linalg.norm(seen)), float(np.linalg.norm(true_px))
    covariance = found.covariance_px2[2:, 2:]
    by_phase = np.concatenate((-seen[2:], seen[:2])) / size
    sd_along = float(np.sqrt(by_phase @ covariance @ by_phase))
    straight = found if found.axes is None else found.axes
    turn = float(np.angle(np.vdot(true_px[:2] + 1j * true_px[2:], seen[:2] + 1j * seen[2:])))
    return SignedError(
        float(np.linalg.norm(seen - true_px)),
        size - true_size,
        turn,
        sd_along / size,
        _length_error(straight, true_size),
        float(by_phase @ (seen - true_px)) / sd_along,
    )


def _length_error(found: Measurement, true_size: float) -> float:
    """Error of the length of (a, b) over its standard deviation."""
    seen = np.concatenate((found.a_px, found.b_px))
    size = float(np.linalg.norm(seen))
    along = seen / size
    return (size - true_size) / float(np.sqrt(along @ found.covariance_px2[2:, 2:] @ along))


def rms_interval(values: FloatArray, share: float = 0.95) -> tuple[float, float, float]:
    """Root mean square, and the interval that holds the one of many trials with a probability (bootstrap)."""
    if not values.size:
        return (float("nan"),) * 3
    squares = np.asarray(values, np.float64) ** 2
    drawn = np.random.default_rng(0).integers(0, squares.size, (RESAMPLES, squares.size))
    roots = np.sqrt(squares[drawn].mean(axis=1))
    low, high = np.quantile(roots, [(1 - share) / 2, (1 + share) / 2])
    return float(np.sqrt(squares.mean())), float(low), float(high)


def interval_text(values: FloatArray) -> str:
    """Root mean square with its 95 % interval."""
    middle, low, high = rms_interval(values)
    return f"{middle:5.2f} ({low:4.2f}–{high:4.2f})"
