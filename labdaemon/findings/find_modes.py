"""Modes of a series, found one after the other, each with the evidence for it.

A mode is added at the best place of a scan, the whole model is fitted again, and the mode stays if

- the likelihood ratio says so: the fall of χ² is beyond what the best of all places of the band reaches without a mode
  (a chi-square or F test, its p-value multiplied by the number of independent places: Bonferroni);
- its pole is one of a passive structure inside the band: damping positive, frequency within the band;
- it is determined: the frequency to within its half-bandwidth, the damping to within a factor of two.

What fails is not reported as a mode; the reason is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labdaemon.findings.linearise import ModalProblem
from labdaemon.findings.modal_basis import ModalBasis, ModeForm
from labdaemon.findings.modal_fit import ModalFit, add_residual_term, fit, initial_parameters, remove_mode
from labdaemon.findings.phase_retrieval import fit_with_signs, with_residues
from labdaemon.findings.pole_search import DAMPINGS, PoleCandidate, PoleScan
from labdaemon.findings.response import FloatArray, PhaseReference, ResponseSeries
from labdaemon.findings.signed_steps import with_signed_steps, without_signs

SIGNIFICANCE = 1e-3
"""Probability that a band without a mode shows one."""
HIGHEST_DAMPING = 0.3
"""Above this a pole is a slope, not a resonance."""
LOWEST_DAMPING = 1e-5
RESIDUAL_TERMS = (2, 3, 4)
"""Numbers of residual terms that are tried in turn: the closer the modes outside the band, the more are needed."""
LEAST_STEPS = 5
"""Two for a pole, two for the residual terms, one to contradict."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode with its evidence.

    Attributes
    ----------
    frequency_hz, sd_frequency_hz
        Undamped natural frequency.
    damping, sd_damping
        ζ, a fraction of critical damping.
    p_value
        Probability that a band without a mode shows one as strong anywhere as the weakest of those found.
    index
        Its place in the fit.
    """

    frequency_hz: float
    sd_frequency_hz: float
    damping: float
    sd_damping: float
    p_value: float
    index: int


@dataclass(frozen=True, slots=True, eq=False)
class ModeSearch:
    """Outcome of a search.

    Attributes
    ----------
    modes
        In ascending frequency; empty where there is none.
    reasons
        Why nothing more, or nothing at all, is reported; one sentence each.
    fit
        The model with all modes; None where there were too few steps.
    """

    modes: tuple[Mode, ...]
    reasons: tuple[str, ...]
    fit: ModalFit | None


def find_modes(
    series: ResponseSeries,
    *,
    form: ModeForm = ModeForm.BASE_EXCITATION,
    residual_terms: int | None = None,
    band_hz: tuple[float, float] | None = None,
    most: int = 12,
    is_noise_known: bool = True,
    is_real: bool | None = None,
) -> ModeSearch:
    """Find all modes of a series.

    Parameters
    ----------
    residual_terms
        Of the background; None: as few as explain the data, 2 to 4.
    band_hz
        Where natural frequencies may lie; the range of the steps if None.
    most
        Largest number of modes.
    is_noise_known
        False: the standard deviations are relative weights only, and the noise is estimated from the residuals.
    is_real
        Whether residues are real (proportional damping); None: where phases are unknown.
    """
    if series.signed is not None and series.phase is PhaseReference.TARGET:
        return _with_signs(series, form, residual_terms, band_hz, most)
    usable = int(series.valid().any(axis=(1, 2)).sum())
    if usable < LEAST_STEPS:
        return ModeSearch((), (f"{usable} steps with results: at least {LEAST_STEPS} are needed",), None)
    low, high = band_hz or (float(series.frequency_hz.min()), float(series.frequency_hz.max()))
    if not high > low:
        return ModeSearch((), ("all steps have the same frequency",), None)
    real = series.phase is PhaseReference.TARGET if is_real is None else is_real
    terms = RESIDUAL_TERMS[0] if residual_terms is None else residual_terms
    basis = ModalBasis.over(series.frequency_hz, form, terms)
    problem = ModalProblem.of(series, basis, real)
    search = _Search(problem, PoleScan.of(series, basis), (low, high), is_noise_known)
    return search.run(most, RESIDUAL_TERMS[-1] if residual_terms is None else residual_terms)


def _with_signs(
    series: ResponseSeries, form: ModeForm, residual_terms: int | None, band_hz: tuple[float, float] | None, most: int
) -> ModeSearch:
    """Search by amplitudes, then fit the steps that show phase by their vectors."""
    found = find_modes(
        without_signs(series), form=form, residual_terms=residual_terms, band_hz=band_hz, most=most, is_real=True
    )
    if found.fit is None or not found.modes or not series.signed_steps().any():
        return found
    fitted, reason = with_signed_steps(found.fit, series)
    modes = _modes_of(fitted, found.modes[0].p_value)
    return ModeSearch(modes, (*found.reasons, reason) if reason else found.reasons, fitted)


@dataclass(slots=True)
class _Search:
    problem: ModalProblem
    scan: PoleScan
    band: tuple[float, float]
    is_noise_known: bool

    def run(self, most: int, most_terms: int) -> ModeSearch:
        """Propose poles by the scan, fit all together, and drop what the fit does not support.

        The background then gets as many more terms as the data demand; they take the flanks of modes outside the band.
        """
        poles, reasons = self._propose(most)
        if not self.is_noise_known:
            rest, freedom = self.scan.rest(poles)
            self.problem = self.problem.scaled(float(np.sqrt(rest / max(freedom, 1))) or 1.0)
        current, p_value = self._supported(self._fit(poles), reasons)
        while self.is_noise_known and not _explains(current) and current.problem.basis.residual_terms < most_terms:
            richer = add_residual_term(current)
            if (
                richer.freedom <= 0
                or stats.chi2.sf(current.chi2 - richer.chi2, current.freedom - richer.freedom) > 1e-3
            ):
                break
            current, p_value = self._supported(richer, reasons)
        return ModeSearch(_modes_of(current, p_value), tuple(reasons), current)

    def _supported(self, current: ModalFit, reasons: list[str]) -> tuple[ModalFit, float]:
        """The fit without the poles that are no modes, and the p-value of the weakest that stays."""
        p_value = 1.0
        while current.modes:
            reason, smaller, p_value = self._without_unsupported(current)
            if not reason:
                break
            reasons.append(reason)
            current = smaller
        return current, p_value

    def _propose(self, most: int) -> tuple[tuple[PoleCandidate, ...], list[str]]:
        """Poles that are worth a fit, and why there are no more."""
        poles: tuple[PoleCandidate, ...] = ()
        while len(poles) < most:
            if poles and self.is_noise_known and self._scan_explains(poles):
                return poles, ["no further mode is significant"]
            candidate = self.scan.best(*self.band, poles)
            where = f"a mode near {candidate.frequency_hz:.4g} Hz"
            rest, freedom = self.scan.rest((*poles, candidate))
            added = self.scan.added_parameters()
            if freedom <= 0:
                return poles, [f"{where} cannot be tested: too few steps"]
            if self.is_noise_known:  # what other modes leave is no noise
                single = float(stats.chi2.sf(candidate.gain, added))
            else:
                single = float(stats.f.sf(candidate.gain / added / max(rest / freedom, 1e-300), added, freedom))
            if places(self.problem.series, self.band) * single > SIGNIFICANCE:
                return poles, [f"{where} is not significant"]
            if candidate.damping < 0:
                return poles, [
                    f"the phase rises through {candidate.frequency_hz:.4g} Hz, as of a pole with negative damping: "
                    "not a mode of a passive structure"
                ]
            poles = self.scan.refine_all((*poles, candidate), *self.band)
        return poles, [f"{most} modes are as many as were asked for"]

    def _scan_explains(self, poles: tuple[PoleCandidate, ...]) -> bool:
        """Whether these poles leave no more than noise in what is scanned."""
        rest, freedom = self.scan.rest(poles)
        return freedom <= 0 or bool(stats.chi2.sf(rest, freedom) > SIGNIFICANCE)

    def _fit(self, poles: tuple[PoleCandidate, ...]) -> ModalFit:
        frequency = np.array([one.frequency_hz for one in poles])
        damping = np.array([abs(one.damping) for one in poles])
        start = with_residues(self.problem, initial_parameters(self.problem, frequency, damping))
        return fit_with_signs(self.problem, start)

    def _without(self, current: ModalFit, index: int) -> ModalFit:
        """A fit without one pole: from where the present one stands, or anew where that is worse."""
        warm = fit(current.problem, remove_mode(current, index))
        if current.problem.basis.residual_terms > RESIDUAL_TERMS[0] or not self.is_noise_known:
            return warm
        keep = [k for k in range(current.modes) if k != index]
        at = current.parameters
        poles = tuple(PoleCandidate(float(at.frequency_hz[k]), float(at.damping[k]), 0.0) for k in keep)
        return min(warm, self._fit(poles), key=lambda one: one.chi2)

    def _without_unsupported(self, current: ModalFit) -> tuple[str, ModalFit, float]:
        """Why a pole is dropped (empty: all stay), the fit without it, its p-value."""
        if current.freedom <= 0:
            text = f"{current.modes} modes are more than these steps can test"
            return text, self._without(current, current.modes - 1), 1.0
        unusable = {index: unusable_pole(current, index, self.band) for index in range(current.modes)}
        unusable = {index: reason for index, reason in unusable.items() if reason}
        if unusable:
            # Of poles that spoil each other, the one leaves that the data miss least.
            smaller = {index: self._without(current, index) for index in unusable}
            index = min(smaller, key=lambda one: smaller[one].chi2)
            return unusable[index], smaller[index], 1.0
        weakest = int(np.argmin(wald_statistics(current)))
        without = self._without(current, weakest)
        p_value = significance(without, current, self.band, self.is_noise_known)
        if p_value > SIGNIFICANCE:
            frequency = current.parameters.frequency_hz[weakest]
            text = f"a mode near {frequency:.4g} Hz is not significant (p = {p_value:.2g} over the band searched)"
            return text, without, p_value
        return "", current, p_value


def _explains(fitted: ModalFit) -> bool:
    """Whether the residuals are no larger than the noise."""
    return fitted.freedom <= 0 or bool(stats.chi2.sf(fitted.chi2, fitted.freedom) > SIGNIFICANCE)


def places(series: ResponseSeries, band: tuple[float, float]) -> float:
    """Number of independent places where noise can look like a mode."""
    lines = min(max(np.log(band[1] / band[0]) / (2 * DAMPINGS[0]), 1.0), float(series.steps))
    return float(lines * len(DAMPINGS) / 2)


def wald_statistics(fitted: ModalFit) -> FloatArray:
    """(M,) how far each mode's residues are from zero: cᵀ Cov⁻¹ c per residue."""
    values = []
    for mode in range(fitted.modes):
        residues, covariance = fitted.residues(mode)
        sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        is_seen = np.diag(covariance) > 0
        inner = (covariance / np.outer(sd, sd))[np.ix_(is_seen, is_seen)]
        normalised = (residues / sd)[is_seen]
        values.append(float(normalised @ np.linalg.pinv(inner, hermitian=True) @ normalised) / max(is_seen.sum(), 1))
    return np.array(values)


def significance(before: ModalFit, after: ModalFit, band: tuple[float, float], is_noise_known: bool) -> float:
    """Probability of such a fall of χ² anywhere in the band without a mode.

    Parameters
    ----------
    before, after
        Fits with one mode less and more.
    is_noise_known
        False for an F test against the residuals of `after`.
    """
    added = max(before.freedom - after.freedom, 1)
    fall = max(before.chi2 - after.chi2, 0.0)
    if is_noise_known:
        single = float(stats.chi2.sf(fall / after.scale, added))
    else:
        single = float(stats.f.sf(fall / added / max(after.noise_factor, 1e-300), added, after.freedom))
    return min(1.0, places(after.problem.series, band) * single)


def unusable_pole(fitted: ModalFit, index: int, band: tuple[float, float]) -> str:
    """Why a pole is not reported as a mode; empty where nothing speaks against it."""
    frequency = float(fitted.parameters.frequency_hz[index])
    damping = float(fitted.parameters.damping[index])
    sd_frequency, sd_damping = float(fitted.sd_log_frequency[index]), float(fitted.sd_log_damping[index])
    where = f"a pole at {frequency:.5g} Hz"
    if not band[0] <= frequency <= band[1]:
        return f"{where} lies outside the band {band[0]:.4g} to {band[1]:.4g} Hz"
    if not LOWEST_DAMPING <= damping <= HIGHEST_DAMPING:
        return f"{where} has a damping ratio of {damping:.2g}: no resonance"
    if not sd_frequency < damping:
        return f"{where} is not determined: its sd exceeds its half-bandwidth"
    if not sd_damping < 0.5:
        return f"{where} is not determined: the sd of its damping is {100 * sd_damping:.0f} % of it"
    return ""


def _modes_of(fitted: ModalFit, p_value: float) -> tuple[Mode, ...]:
    frequency: FloatArray = fitted.parameters.frequency_hz
    damping = fitted.parameters.damping
    sd_f, sd_z = fitted.sd_log_frequency * frequency, fitted.sd_log_damping * damping
    order = np.argsort(frequency)
    return tuple(
        Mode(float(frequency[i]), float(sd_f[i]), float(damping[i]), float(sd_z[i]), p_value, int(i)) for i in order
    )
