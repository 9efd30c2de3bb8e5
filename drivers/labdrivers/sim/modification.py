"""The two modifications of McCarthy 2016: a mass on the fourth level, and two members between levels two and three cut.

The unmodified frame's modes are the basis (Rayleigh–Ritz): in their coordinates its mass and stiffness are diagonal. A
mass at a point adds m·s(P)·s(P)ᵀ, a thinner member takes Δk·d·dᵀ away, with d each mode's difference of displacement
between the member's ends. Both stand on one side of the frame, so that the modified modes sway and twist together, as
the paper observed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from labdrivers.sim.structure import DEFAULT_MODES, HEIGHT_MM, FloatArray, VibrationMode

FLOOR_KG = 0.5
"""Mass of one of the four floors."""
MEMBER_N_MM = 1.19
"""Sway stiffness of one of a storey's four members: a shear frame of such floors has its first mode near 5.4 Hz."""
CORNERS_MM = ((-150.0, -100.0), (150.0, -100.0), (150.0, 100.0), (-150.0, 100.0))


@dataclass(frozen=True, slots=True)
class Modification:
    """What is done to the frame.

    Attributes
    ----------
    mass_kg, mass_mm
        Added mass and its place (x, y, z).
    member_loss
        Part of their stiffness that the cut members lose.
    members
        Their corners (indices into `CORNERS_MM`).
    between
        Levels between which they stand.
    """

    mass_kg: float = 0.0
    mass_mm: tuple[float, float, float] = (110.0, -60.0, HEIGHT_MM)
    member_loss: float = 0.0
    members: tuple[int, ...] = (1, 2)
    between: tuple[int, int] = (2, 3)


MODIFICATIONS = {
    "none": Modification(),
    "mass": Modification(mass_kg=0.05),
    "thinned": Modification(mass_kg=0.05, member_loss=0.5),
    "thinned-only": Modification(member_loss=0.5),
}
"""By name: the paper's first modification, its second (in addition to the first), and the second alone."""


def modified_modes(
    modification: Modification, modes: tuple[VibrationMode, ...] = DEFAULT_MODES
) -> tuple[VibrationMode, ...]:
    """Modes of the modified frame, in ascending frequency.

    Raises
    ------
    ValueError
        Members lose all their stiffness or more, or masses are negative.
    """
    if not (0 <= modification.member_loss < 1 and modification.mass_kg >= 0):
        raise ValueError(f"a loss of {modification.member_loss:g} or a mass of {modification.mass_kg:g} kg cannot be")
    if modification.mass_kg == 0 and modification.member_loss == 0:
        return modes
    levels = HEIGHT_MM * np.arange(1, 5) / 4
    corners = np.array([(x, y, z) for z in levels for x, y in CORNERS_MM])
    shapes = np.stack([mode.shape(corners) for mode in modes])
    # kg: in the coordinate of a mode, whose shape contains the participation factor, mass and load are the same number.
    generalised = np.sum(shapes**2, axis=(1, 2)) * FLOOR_KG / len(CORNERS_MM)
    omega2 = (2 * np.pi * np.array([mode.frequency_hz for mode in modes])) ** 2
    mass, stiffness, load = np.diag(generalised), np.diag(generalised * omega2), generalised.copy()
    at = np.stack([mode.shape(np.array([modification.mass_mm]))[0] for mode in modes])
    mass += modification.mass_kg * at @ at.T
    load += modification.mass_kg * at[:, 0]
    for member in modification.members:
        x, y = CORNERS_MM[member]
        ends = np.array([(x, y, HEIGHT_MM * level / 4) for level in modification.between])
        drift = np.stack([np.diff(mode.shape(ends), axis=0)[0, :2] for mode in modes])
        stiffness -= modification.member_loss * 1e3 * MEMBER_N_MM * drift @ drift.T
    return tuple(_combined(modes, *pair, load) for pair in _eigenpairs(stiffness, mass))


def _eigenpairs(stiffness: FloatArray, mass: FloatArray) -> list[tuple[float, FloatArray]]:
    squares, vectors = eigh(stiffness, mass)
    if squares[0] <= 0:
        raise ValueError("the modified frame has no stiffness left in a mode")
    return [(float(np.sqrt(square)), vector) for square, vector in zip(squares, vectors.T, strict=True)]


def _combined(modes: tuple[VibrationMode, ...], omega: float, vector: FloatArray, load: FloatArray) -> VibrationMode:
    """One modified mode: a sum of the old shapes, scaled with its participation factor."""
    weights = vector * float(vector @ load)
    main = int(np.argmax(np.abs(vector)))
    parts = tuple((float(weight), mode) for weight, mode in zip(weights, modes, strict=True))
    return replace(modes[main], frequency_hz=omega / (2 * np.pi), parts=parts)
