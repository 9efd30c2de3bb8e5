"""Mode shapes with their covariance, and what is read from them, each number with its standard deviation.

A shape here is the residue of a mode: mode shape times participation factor, mm of the target per mm of the table when
multiplied by f²/(f_r² − f² + 2iζ_r f_r f). So it needs no masses, and a uniform change of mass or stiffness leaves it
unchanged. `unit_scaled` gives the usual form with the largest component 1.

MPC: Juang and Pappa 1985, doi:10.2514/3.20031. Curvature as an indicator of damage: Pandey, Biswas and Samman 1991,
doi:10.1016/0022-460X(91)90595-B.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from labdaemon.findings.members import levels, members, targets_of_levels
from labdaemon.findings.modal_fit import ModalFit
from labdaemon.findings.propagation import Estimate, propagate, propagate_linear
from labdaemon.findings.response import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ModeShape:
    """The shape of one mode.

    Attributes
    ----------
    values
        (T·D,) real, or (2·T·D,) with the imaginary parts behind the real ones; mm per mm of the table.
    covariance
        Of `values`.
    positions_mm
        (T, 3) of the targets.
    is_complex
        Whether imaginary parts are there.
    """

    values: FloatArray
    covariance: FloatArray
    positions_mm: FloatArray
    is_complex: bool = False

    @classmethod
    def of(cls, fitted: ModalFit, mode: int, positions_mm: FloatArray) -> ModeShape:
        """The shape of a fit's mode."""
        values, covariance = fitted.residues(mode)
        return cls(values, covariance, np.asarray(positions_mm, float), fitted.parts == 2)

    @property
    def vectors(self) -> ComplexArray:
        """(T, D) complex displacements."""
        return as_complex(self.values, self.is_complex).reshape(len(self.positions_mm), -1)

    def direction(self) -> FloatArray:
        """(D,) unit vector along which most of the motion is; its largest component is positive."""
        moment = (self.vectors.conj().T @ self.vectors).real
        vector = np.linalg.eigh(moment)[1][:, -1]
        result: FloatArray = vector * np.sign(vector[np.argmax(np.abs(vector))])
        return result

    def unit_scaled(self) -> ModeShape:
        """The shape divided by its largest component; the covariance follows as if that component were exact."""
        largest = float(self.values[np.argmax(np.abs(self.values))])
        return ModeShape(self.values / largest, self.covariance / largest**2, self.positions_mm, self.is_complex)

    def turned_real(self) -> ModeShape:
        """A complex shape at the phase at which most of it is real; a real one as it is."""
        if not self.is_complex:
            return self
        vector = as_complex(self.values, True)
        angle = 0.5 * np.angle(np.sum(vector**2))
        turned = vector * np.exp(-1j * angle)
        cos, sin = np.cos(angle) * np.eye(len(vector)), np.sin(angle) * np.eye(len(vector))
        jacobian = np.block([[cos, sin], [-sin, cos]])
        values = np.concatenate([turned.real, turned.imag])
        return ModeShape(values, jacobian @ self.covariance @ jacobian.T, self.positions_mm, True)

    def along_rows(self, targets: NDArray[np.intp], direction: FloatArray) -> FloatArray:
        """(m, n) rows that take the component of some targets along a direction (real parts)."""
        dimension = len(direction)
        rows = np.zeros((len(targets), len(self.values)))
        for row, target in enumerate(targets):
            rows[row, target * dimension : (target + 1) * dimension] = direction
        return rows


def as_complex(values: FloatArray, is_complex: bool) -> ComplexArray:
    """Complex vector of real parts followed by imaginary ones."""
    if not is_complex:
        return values.astype(complex)
    half = len(values) // 2
    result: ComplexArray = values[:half] + 1j * values[half:]
    return result


def mac_value(one: ComplexArray, other: ComplexArray) -> float:
    """Modal assurance criterion: squared cosine of the angle between two vectors."""
    product = float(abs(np.vdot(one, other))) ** 2
    size = float(np.vdot(one, one).real) * float(np.vdot(other, other).real)
    return product / max(size, 1e-300)


def mpc_value(shape: ComplexArray) -> float:
    """Modal phase collinearity: 1 where all targets move in phase or against it."""
    centred = shape
    xx, yy = float(centred.real @ centred.real), float(centred.imag @ centred.imag)
    xy = float(centred.real @ centred.imag)
    return ((xx - yy) ** 2 + 4 * xy**2) / max((xx + yy) ** 2, 1e-300)


def mpc(shape: ModeShape) -> Estimate:
    """Modal phase collinearity; exactly 1 for a real shape."""
    if not shape.is_complex:
        return Estimate(1.0, 0.0)
    return propagate(lambda x: mpc_value(as_complex(x, True)), shape.values, shape.covariance, second_order=True)


@dataclass(frozen=True, slots=True)
class ShapePoint:
    """A node or an antinode.

    Attributes
    ----------
    member
        Index of the member.
    height_mm, sd_mm
        Where on it.
    value, sd_value
        Displacement there (0 of a node), as the shape is scaled.
    """

    member: int
    height_mm: float
    sd_mm: float
    value: float = 0.0
    sd_value: float = 0.0


def nodes(shape: ModeShape) -> list[ShapePoint]:
    """Where the displacement along the mode's direction changes its sign on each member."""
    found = []
    direction = shape.direction()
    for number, member in enumerate(members(shape.positions_mm)):
        rows = shape.along_rows(member, direction)
        values, height = rows @ shape.values, shape.positions_mm[member, 2]
        covariance = rows @ shape.covariance @ rows.T
        for k in np.flatnonzero(values[:-1] * values[1:] < 0):
            pair, gap = slice(k, k + 2), height[k + 1] - height[k]
            low, high = values[pair]
            share = low / (low - high)
            gradient = np.array([-high, low]) / (low - high) ** 2
            sd = gap * float(np.sqrt(gradient @ covariance[pair, pair] @ gradient))
            found.append(ShapePoint(number, float(height[k] + share * gap), sd))
    return found


def _vertex(height_mm: FloatArray, item: int, values: FloatArray) -> float:
    """Height (item 0) or value (item 1) of the vertex of the parabola through three points."""
    c2, c1, c0 = np.polyfit(height_mm - height_mm[1], values, 2)
    return float(height_mm[1] - c1 / (2 * c2)) if item == 0 else float(c0 - c1**2 / (4 * c2))


def antinodes(shape: ModeShape) -> list[ShapePoint]:
    """Where the displacement along the mode's direction is largest between targets, by a parabola through three."""
    found = []
    direction = shape.direction()
    for number, member in enumerate(members(shape.positions_mm)):
        rows = shape.along_rows(member, direction)
        values, height = rows @ shape.values, shape.positions_mm[member, 2]
        covariance = rows @ shape.covariance @ rows.T
        for k in range(1, len(member) - 1):
            if not (abs(values[k]) > abs(values[k - 1]) and abs(values[k]) > abs(values[k + 1])):
                continue
            part = slice(k - 1, k + 2)
            ends = [
                propagate(partial(_vertex, height[part], item), values[part], covariance[part, part]) for item in (0, 1)
            ]
            place, value = ends
            found.append(ShapePoint(number, place.value, place.sd, value.value, value.sd))
    return found


def curvature_rows(shape: ModeShape) -> tuple[FloatArray, list[tuple[int, float]]]:
    """Rows (q, n) that give the second derivative along each member, 1/mm², and (member, height) of each."""
    direction = shape.direction()
    blocks, places = [np.zeros((0, len(shape.values)))], []
    for number, member in enumerate(members(shape.positions_mm)):
        rows, height = shape.along_rows(member, direction), shape.positions_mm[member, 2]
        for k in range(1, len(member) - 1):
            below, above = height[k] - height[k - 1], height[k + 1] - height[k]
            weights = np.array([1 / below, -1 / below - 1 / above, 1 / above]) * 2 / (below + above)
            blocks.append((weights @ rows[k - 1 : k + 2])[None])
            places.append((number, float(height[k])))
    return np.concatenate(blocks), places


def curvature(shape: ModeShape) -> list[tuple[int, float, Estimate]]:
    """Second derivative along each member: (member, height, estimate in 1/mm² per unit of the shape)."""
    rows, places = curvature_rows(shape)
    return [
        (*place, one) for place, one in zip(places, propagate_linear(rows, shape.values, shape.covariance), strict=True)
    ]


@dataclass(frozen=True, slots=True)
class SectionMotion:
    """How the section at a level moves.

    Attributes
    ----------
    height_mm
        Of the level.
    sway_x, sway_y
        Mean displacement, as the shape is scaled.
    torsion_per_mm
        Rotation about the vertical, rad per unit of the shape.
    """

    height_mm: float
    sway_x: Estimate
    sway_y: Estimate
    torsion_per_mm: Estimate


def section_motions(shape: ModeShape) -> list[SectionMotion]:
    """Sway and torsion at each level with at least two targets apart from each other."""
    found = []
    heights = levels(shape.positions_mm)
    for height, group in zip(heights, targets_of_levels(shape.positions_mm, heights), strict=True):
        spread = shape.positions_mm[group, :2] - shape.positions_mm[group, :2].mean(axis=0)
        if len(group) < 2 or np.abs(spread).max() < 1.0:
            continue
        x, y = (shape.along_rows(group, unit) for unit in np.eye(3)[:2])
        arm = float(np.sum(spread**2))
        rotation = (spread[:, 0] @ y - spread[:, 1] @ x) / arm
        rows = np.stack([x.mean(axis=0), y.mean(axis=0), rotation])
        found.append(SectionMotion(float(height), *propagate_linear(rows, shape.values, shape.covariance)))
    return found


def share_along(shape: ModeShape, axis: int) -> Estimate:
    """Part of the squared motion that is along one axis: 1 (y) and 2 (z) are out of the table's direction."""

    def value(x: FloatArray) -> float:
        vectors = as_complex(x, shape.is_complex).reshape(len(shape.positions_mm), -1)
        return float(np.sum(np.abs(vectors[:, axis]) ** 2) / max(float(np.sum(np.abs(vectors) ** 2)), 1e-300))

    return propagate(value, shape.values, shape.covariance, second_order=len(shape.values) <= 200)
