"""Where the next mode could be: a scan over natural frequency and damping, with everything linear solved exactly.

For each pair of a grid the fall of the weighted sum of squares is computed that a mode there would bring. The terms
that are in the model already are projected out. Complex data are scanned as they are; amplitudes are scanned in their
squares, which are linear in all but the poles (`modal_basis.squared_columns`).

The grid contains negative damping, too. Data without a resonance, such as noise divided by noise, are often best
described by an unstable pole; a mode of a passive structure is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.findings.modal_basis import ModalBasis, squared_columns
from labdaemon.findings.response import ComplexArray, FloatArray, PhaseReference, ResponseSeries

DAMPINGS = (0.0007, 0.002, 0.005, 0.012, 0.03, 0.08)
"""Of the first grid: a factor of 2.5 apart, which costs no more than a few per cent of the fall."""
STEPS_PER_BANDWIDTH = 2.0
"""Grid points per half-bandwidth; closer ones find nothing that refinement would not."""
MOST_POINTS = 4000
REFINEMENTS = 6
COMPONENTS = 8
"""Combinations of channels that are scanned; the fit uses all channels."""


@dataclass(frozen=True, slots=True)
class PoleCandidate:
    """A place of the scan.

    Attributes
    ----------
    frequency_hz, damping
        Where; damping is negative for an unstable pole.
    gain
        Fall of the weighted sum of squares.
    """

    frequency_hz: float
    damping: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class PoleScan:
    """Prepared data of a scan.

    Attributes
    ----------
    frequency_hz
        (K,).
    values, weights
        (C, K) of all channels; weights are 0 where there is no number.
    is_squared
        Whether the values are squared amplitudes.
    basis
        Form of the modes.
    """

    frequency_hz: FloatArray
    values: ComplexArray
    weights: FloatArray
    is_squared: bool
    basis: ModalBasis

    @classmethod
    def of(cls, series: ResponseSeries, basis: ModalBasis) -> PoleScan:
        """Prepare a series."""
        steps = series.steps
        valid = series.valid().reshape(steps, -1).T
        value = np.where(valid, (series.amplitude / series.table_mm[:, None, None]).reshape(steps, -1).T, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            sd = np.where(valid, (series.sd_real / series.table_mm[:, None, None]).reshape(steps, -1).T, 1.0)
        table = series.sd_table[None, :]
        if series.phase is PhaseReference.TABLE:
            table = np.hypot(table, series.sd_phase()[None, :])
            weight = np.where(valid, 1 / np.hypot(sd, np.abs(value) * table), 0.0)
            value, weight = compress(value, weight, table)
            return cls(series.frequency_hz, value, weight, False, basis)
        square = np.abs(value) ** 2
        error = np.sqrt((2 * np.abs(value) * sd) ** 2 + 2 * sd**4 + (2 * square * table) ** 2)
        both = compress(square.astype(complex), np.where(valid, 1 / error, 0.0), 2 * table)
        return cls(series.frequency_hz, *both, True, basis)

    def grid(self, low_hz: float, high_hz: float) -> tuple[FloatArray, FloatArray]:
        """Frequencies and dampings of the first scan; squared amplitudes do not know the sign of damping."""
        frequency, damping = [], []
        for zeta in DAMPINGS:
            count = STEPS_PER_BANDWIDTH * np.log(high_hz / low_hz) / zeta
            points = np.geomspace(low_hz, high_hz, int(np.clip(count, 8, MOST_POINTS / len(DAMPINGS))))
            for sign in (1.0,) if self.is_squared else (1.0, -1.0):
                frequency.append(points)
                damping.append(np.full(len(points), sign * zeta))
        return np.concatenate(frequency), np.concatenate(damping)

    def _columns(self, frequency_hz: FloatArray, damping: FloatArray) -> ComplexArray:
        """(K, G, 1 or 2) columns of G candidates."""
        if self.is_squared:
            both = squared_columns(self.frequency_hz, frequency_hz, np.abs(damping))
            return both.reshape(len(self.frequency_hz), 2, -1).transpose(0, 2, 1).astype(complex)
        return self.basis.modes(self.frequency_hz, frequency_hz, damping)[:, :, None]

    def _known_columns(self, known: tuple[PoleCandidate, ...]) -> ComplexArray:
        """(K, p) columns of the residual terms and of the modes that the model already has."""
        terms = self.basis.residuals(self.frequency_hz)
        if self.is_squared:  # the square of a polynomial of f²
            x = (self.frequency_hz / self.basis.centre_hz) ** 2
            terms = np.stack([x**k for k in range(max(2 * self.basis.residual_terms - 1, 1))], axis=1).astype(complex)
        if not known:
            return terms
        frequency = np.array([one.frequency_hz for one in known])
        damping = np.array([one.damping for one in known])
        columns = self._columns(frequency, damping)
        return np.hstack([terms, columns.reshape(len(columns), -1)])

    def gains(self, frequency_hz: FloatArray, damping: FloatArray, known: tuple[PoleCandidate, ...]) -> FloatArray:
        """(G,) falls of the weighted sum of squares that one more mode brings."""
        base, columns = self._known_columns(known), self._columns(frequency_hz, damping)
        steps, count, each = columns.shape
        flat = columns.reshape(steps, -1)
        total = np.zeros(count)
        for value, weight in zip(self.values, self.weights, strict=True):
            q, r = np.linalg.qr(base * weight[:, None])
            seen = np.abs(np.diag(r)) > 1e-10 * max(float(np.abs(r).max()), 1e-300)
            q = q[:, seen]
            if np.count_nonzero(weight) <= q.shape[1] + each:
                continue
            rest = value * weight
            rest = rest - q @ (q.conj().T @ rest)
            weighted = flat * weight[:, None]
            before = np.sum(np.abs(weighted) ** 2, axis=0).reshape(count, each)
            weighted = (weighted - q @ (q.conj().T @ weighted)).reshape(steps, count, each)
            first = weighted[:, :, 0]
            length2 = np.sum(np.abs(first) ** 2, axis=0)
            along = first.conj().T @ rest
            is_seen = length2 > 1e-10 * before[:, 0]
            total += np.where(is_seen, np.abs(along) ** 2 / np.maximum(length2, 1e-300), 0.0)
            if each == 2:
                total += self._second(first, weighted[:, :, 1], before[:, 1], rest, length2, along)
        return total

    @staticmethod
    def _second(
        first: ComplexArray,
        second: ComplexArray,
        before: FloatArray,
        rest: ComplexArray,
        length2: FloatArray,
        along: ComplexArray,
    ) -> FloatArray:
        """What a candidate's second column adds once the first is projected out."""
        factor = np.sum(first.conj() * second, axis=0) / np.maximum(length2, 1e-300)
        second = second - first * factor
        size2 = np.sum(np.abs(second) ** 2, axis=0)
        on_rest = second.conj().T @ (rest)
        result: FloatArray = np.where(size2 > 1e-10 * before, np.abs(on_rest) ** 2 / np.maximum(size2, 1e-300), 0.0)
        return result

    def rest(self, known: tuple[PoleCandidate, ...]) -> tuple[float, int]:
        """Weighted sum of squares that the known poles leave, and its degrees of freedom (real numbers)."""
        base, total, freedom = self._known_columns(known), 0.0, -2 * len(known)
        for value, weight in zip(self.values, self.weights, strict=True):
            q, r = np.linalg.qr(base * weight[:, None])
            q = q[:, np.abs(np.diag(r)) > 1e-10 * max(float(np.abs(r).max()), 1e-300)]
            rest = value * weight
            total += float(np.sum(np.abs(rest - q @ (q.conj().T @ rest)) ** 2))
            freedom += (1 if self.is_squared else 2) * max(np.count_nonzero(weight) - q.shape[1], 0)
        return total, freedom

    def added_parameters(self) -> int:
        """Real parameters that one more mode has: its pole, and its residues in all channels."""
        return 2 + 2 * int(np.count_nonzero((self.weights > 0).any(axis=1)))

    def refine_all(
        self, poles: tuple[PoleCandidate, ...], low_hz: float, high_hz: float, rounds: int = 2
    ) -> tuple[PoleCandidate, ...]:
        """Refine each pole in turn with the others known."""
        for _ in range(rounds if len(poles) > 1 else 0):
            for index, one in enumerate(poles):
                others = poles[:index] + poles[index + 1 :]
                better = self.refine(PoleCandidate(one.frequency_hz, one.damping, 0.0), others, low_hz, high_hz)
                poles = (*poles[:index], better, *poles[index + 1 :])
        return poles

    def best(self, low_hz: float, high_hz: float, known: tuple[PoleCandidate, ...] = ()) -> PoleCandidate:
        """The place of the largest fall, refined around the best point of the grid."""
        return self.best_of(*self.grid(low_hz, high_hz), low_hz, high_hz, known)

    def best_of(
        self,
        frequency_hz: FloatArray,
        damping: FloatArray,
        low_hz: float,
        high_hz: float,
        known: tuple[PoleCandidate, ...] = (),
    ) -> PoleCandidate:
        """The same over a grid of one's own."""
        gains = self.gains(frequency_hz, damping, known)
        return self.refine(_candidate(frequency_hz, damping, gains), known, low_hz, high_hz)

    def refine(
        self, start: PoleCandidate, known: tuple[PoleCandidate, ...], low_hz: float, high_hz: float
    ) -> PoleCandidate:
        """Climb from a place on ever finer grids."""
        best, width = start, 1.0
        for _ in range(REFINEMENTS):
            shifts = np.linspace(-2.0, 2.0, 9) * width * abs(best.damping)
            factors = 2.5 ** (np.linspace(-1.0, 1.0, 5) * width)
            frequency, damping = np.meshgrid(best.frequency_hz * np.exp(shifts), best.damping * factors, indexing="ij")
            frequency = np.clip(frequency.ravel(), low_hz, high_hz)
            found = _candidate(frequency, damping.ravel(), self.gains(frequency, damping.ravel(), known))
            best, width = (found if found.gain >= best.gain else best), width * 0.5
        return best


def compress(values: ComplexArray, weights: FloatArray, common: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Few combinations of the channels (C, K) that show nearly all of what they show, with their weights.

    Any linear combination of channels has the same poles. Principal components of the channels, each in units of its
    own noise, are taken; channels with gaps are left out, unless most have some.

    Parameters
    ----------
    common
        (1, K) relative error that all channels share.
    """
    steps = (weights > 0).mean(axis=0) > 0.5
    whole = (weights[:, steps] > 0).all(axis=1)
    if len(values) <= COMPONENTS or not steps.any() or not whole.any() or whole.sum() < 0.5 * len(values):
        return values, weights
    inside = np.ix_(whole, steps)
    value, error = values[inside], 1 / weights[inside]
    unit = np.median(error, axis=1, keepdims=True)
    left, _, _ = np.linalg.svd(value / unit, full_matrices=False)
    mix = left[:, :COMPONENTS].conj().T
    combined = mix @ (value / unit)
    own = np.maximum((error / unit) ** 2 - (np.abs(value / unit) * common[:, steps]) ** 2, 1e-12)
    variance = np.abs(mix) ** 2 @ own + (np.abs(combined) * common[:, steps]) ** 2
    result, weight = np.zeros((len(mix), values.shape[1]), complex), np.zeros((len(mix), values.shape[1]))
    result[:, steps], weight[:, steps] = combined, 1 / np.sqrt(variance)
    return result, weight


def _candidate(frequency: FloatArray, damping: FloatArray, gains: FloatArray) -> PoleCandidate:
    index = int(np.argmax(gains))
    return PoleCandidate(float(frequency[index]), float(damping[index]), float(gains[index]))
