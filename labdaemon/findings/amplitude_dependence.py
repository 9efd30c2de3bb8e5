"""Whether a structure answers in proportion: two sweeps at different levels of excitation must have the same poles.

Friction raises the damping at small amplitudes, slack joints and plastics lower the frequencies at large ones. The test
is that of two states whose frequencies and dampings are compared without any common change; shapes play no part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.max_statistic import max_test
from labdaemon.findings.modal_fit import ModalFit
from labdaemon.findings.response import FloatArray

SAME_MODE = 0.1
"""Largest relative difference of frequency of one mode at two levels."""


@dataclass(frozen=True, slots=True)
class AmplitudeDependence:
    """Outcome.

    Attributes
    ----------
    is_dependent, p_value
        At a false-alarm rate of 5 % over all modes.
    frequency_hz
        (M,) of the modes that both sweeps have, at the lower level.
    frequency_change, damping_change
        (M,) relative, higher minus lower level.
    z_frequency, z_damping
        (M,) the same over their standard deviations.
    """

    is_dependent: bool
    p_value: float
    frequency_hz: tuple[float, ...]
    frequency_change: tuple[float, ...]
    damping_change: tuple[float, ...]
    z_frequency: tuple[float, ...]
    z_damping: tuple[float, ...]


def compare_levels(low: ModalFit, high: ModalFit) -> AmplitudeDependence:
    """Compare the poles of two sweeps at different levels of excitation."""
    pairs = []
    for i, frequency in enumerate(low.parameters.frequency_hz):
        if high.modes:
            j = int(np.argmin(np.abs(high.parameters.log_frequency - np.log(frequency))))
            if abs(high.parameters.frequency_hz[j] / frequency - 1) < SAME_MODE:
                pairs.append((i, j))
    pairs.sort(key=lambda pair: low.parameters.log_frequency[pair[0]])
    one, two = (_poles(fitted, [pair[side] for pair in pairs]) for side, fitted in enumerate((low, high)))
    difference, covariance = two[0] - one[0], one[1] + two[1]
    count = len(pairs)
    found = max_test(np.eye(2 * count), difference, covariance, ["frequency"] * count + ["damping"] * count)
    return AmplitudeDependence(
        found.is_changed,
        found.p_value,
        tuple(float(low.parameters.frequency_hz[i]) for i, _ in pairs),
        tuple(difference[:count].tolist()),
        tuple(difference[count:].tolist()),
        tuple(found.z[:count].tolist()),
        tuple(found.z[count:].tolist()),
    )


def _poles(fitted: ModalFit, modes: list[int]) -> tuple[FloatArray, FloatArray]:
    """Logarithms of frequencies and dampings of some modes, with their covariance."""
    index = np.array([*modes, *(fitted.modes + mode for mode in modes)], dtype=int)
    values = np.concatenate([fitted.parameters.log_frequency, fitted.parameters.log_damping])[index]
    return values, fitted.scale * fitted.covariance.shared[np.ix_(index, index)]
