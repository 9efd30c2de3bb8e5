"""What changes everywhere in the same way is no damage: temperature, mass everywhere, table amplitude, moved cameras.

A uniform change of modulus or of mass multiplies all natural frequencies by one factor and leaves the shapes as they
are; temperature also multiplies all dampings. Another table amplitude, or an error of scale, multiplies all of a mode's
shape; cameras that were moved and oriented anew turn all displacements. These are columns of a linear model of the
differences; what they explain is reported by their names, and only the rest is tested.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.modal_state import ModalState
from labdaemon.findings.response import FloatArray

REPORTED_Z = 3.0
"""A common change is reported from so many of its sd on."""


@dataclass(frozen=True, slots=True)
class CommonChange:
    """A change that is the same everywhere.

    Attributes
    ----------
    what
        Name: ``uniform_stiffness_or_mass``, ``uniform_damping``, ``amplitude_scale``, ``rotation``.
    value, sd
        Relative change of all frequencies, of all dampings, of a mode's amplitude; angle in rad.
    text
        One sentence.
    """

    what: str
    value: float
    sd: float
    text: str

    @property
    def z(self) -> float:
        """Value over sd."""
        return self.value / self.sd if self.sd > 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CommonFit:
    """Differences without what a common change explains.

    Attributes
    ----------
    rest
        (n,) differences minus their common part.
    covariance
        Of `rest`; it is singular along the common changes.
    weight
        (n, n) inverse covariance of the differences.
    columns
        (n, c) the common changes.
    changes
        What is large enough to be reported.
    """

    rest: FloatArray
    covariance: FloatArray
    weight: FloatArray
    columns: FloatArray
    changes: tuple[CommonChange, ...]


def common_columns(baseline: ModalState, *, same_scale: bool) -> tuple[FloatArray, list[str]]:
    """(n, c) derivatives of the differences by each common change, and their names.

    Parameters
    ----------
    same_scale
        Temperature and table amplitude are vouched for: frequencies and dampings have no common change.
    """
    modes, size = baseline.modes, baseline.shapes[0].size
    length = 2 * modes + modes * size
    columns, names = [], []
    if not same_scale:
        for first, name in ((0, "uniform_stiffness_or_mass"), (modes, "uniform_damping")):
            column = np.zeros(length)
            column[first : first + modes] = 1.0
            columns.append(column)
            names.append(name)
    for mode in range(modes):
        column = np.zeros(length)
        start = 2 * modes + mode * size
        column[start : start + size] = baseline.shapes[mode].ravel()
        columns.append(column)
        names.append("amplitude_scale")
    if baseline.shapes.shape[2] == 3:
        for axis in np.eye(3):
            column = np.zeros(length)
            column[2 * modes :] = np.cross(axis, baseline.shapes).ravel()
            columns.append(column)
            names.append("rotation")
    return np.stack(columns, axis=1), names


def fit_common(baseline: ModalState, difference: FloatArray, covariance: FloatArray, *, same_scale: bool) -> CommonFit:
    """Generalised least-squares estimate of the common changes, and what they leave."""
    columns, names = common_columns(baseline, same_scale=same_scale)
    weight = inverse(covariance)
    normal = columns.T @ weight @ columns
    inner = inverse(normal)
    value = inner @ (columns.T @ (weight @ difference))
    rest = difference - columns @ value
    left = covariance - columns @ inner @ columns.T
    sd = np.sqrt(np.maximum(np.diag(inner), 0.0))
    return CommonFit(rest, 0.5 * (left + left.T), weight, columns, tuple(_reported(names, value, sd)))


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a covariance or normal matrix on a unit diagonal; directions without variance are left out."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inner = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-11, hermitian=True)
    result: FloatArray = inner / np.outer(scale, scale)
    return result


def _reported(names: list[str], value: FloatArray, sd: FloatArray) -> list[CommonChange]:
    texts = {
        "uniform_stiffness_or_mass": "all natural frequencies changed by {0:+.4f} % (temperature, or mass everywhere)",
        "uniform_damping": "all damping ratios changed by {0:+.1f} %",
        "amplitude_scale": "all amplitudes of mode {1} changed by {0:+.2f} % (table amplitude, scale)",
        "rotation": "the displacements are turned by {2:.3f} degrees about {3} (cameras moved or oriented anew)",
    }
    found, counts = [], dict.fromkeys(names, 0)
    for name, one, error in zip(names, value, sd, strict=True):
        counts[name] += 1
        if error > 0 and abs(one) > REPORTED_Z * error:
            axis = "xyz"[counts[name] - 1] if name == "rotation" else ""
            text = texts[name].format(100 * one, counts[name], np.degrees(one), axis)
            found.append(CommonChange(name, float(one), float(error), text))
    return found
