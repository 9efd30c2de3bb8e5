"""Modes in dense spectra: frequency response functions, or Fourier transforms of free decays, without a person.

A wide band is searched through overlapping windows. In each the spectra are a polynomial of frequency plus one or two
poles (a local rational model: McKelvey and Guérin 2012, doi:10.3182/20120711-3-BE-2027.00299). The noise is estimated
from what no pole explains. A mode that several windows show is reported once, from a window that fits its bandwidth.

A free decay that lasts the whole record has a Fourier transform that is exactly rational in its poles, so that neither
leakage nor windows bias it. Record and decay must begin together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from labdaemon.findings.find_modes import SIGNIFICANCE, Mode, ModeSearch, find_modes
from labdaemon.findings.modal_basis import ModalBasis, ModeForm
from labdaemon.findings.pole_search import PoleCandidate, PoleScan
from labdaemon.findings.response import ComplexArray, FloatArray, ResponseSeries, frequency_response

WINDOW_LINES = (40, 160)
"""Lines of a window: the second sees modes that are wider than the first."""
RESIDUAL_TERMS = 3
HALF_BANDWIDTHS = 20.0
"""Half width of a mode's own window."""
LEAST_LINES, MOST_LINES = 16, 80
"""Least and largest half width of a mode's own window, lines."""
NARROWEST_LINES = 0.25
"""Half-bandwidths below so many lines look like a tone (mains, a machine), whose damping nothing shows."""
NEIGHBOUR_REST = 0.1
"""A second mode in a window must leave less than this of the squares that one leaves."""
WIDEST_NEIGHBOUR = 3.0
"""A second pole whose damping differs by more than this factor shapes background or noise."""
SAME_MODE_BANDWIDTHS = 2.0
"""Poles that are closer than so many half-bandwidths, seen from different windows, are one mode."""


@dataclass(frozen=True, slots=True)
class SpectralModes:
    """Modes of dense spectra.

    Attributes
    ----------
    modes
        In ascending frequency.
    reasons
        What was looked at and not reported, one sentence each.
    """

    modes: tuple[Mode, ...]
    reasons: tuple[str, ...]


def find_spectral_modes(frequency_hz: FloatArray, spectra: ComplexArray) -> SpectralModes:
    """Find the modes of complex spectra.

    Parameters
    ----------
    frequency_hz
        (K,) equally spaced, ascending, positive.
    spectra
        (K, C) of C channels.
    """
    series = frequency_response(np.asarray(frequency_hz, float), np.asarray(spectra, complex).reshape(len(spectra), -1))
    found: list[Mode] = []
    reasons: dict[str, None] = {}
    for candidate in _candidates(series):
        search = _own_window(series, candidate)
        found += search.modes
        if not search.modes:
            reasons |= dict.fromkeys(search.reasons)
    kept: list[Mode] = []
    for mode in sorted(found, key=lambda one: one.sd_damping / one.damping):
        if all(not _is_same(mode, other) for other in kept):
            kept.append(mode)
    return SpectralModes(tuple(sorted(kept, key=lambda one: one.frequency_hz)), tuple(reasons))


def _candidates(series: ResponseSeries) -> list[PoleCandidate]:
    """Places that a window shows with significance, the strongest of each neighbourhood."""
    frequency = series.frequency_hz
    found: list[PoleCandidate] = []
    for wanted in WINDOW_LINES:
        lines = min(wanted, len(frequency))
        for first in range(0, max(len(frequency) - lines, 0) + 1, max(lines // 4, 1)):
            part = slice(first, first + lines)
            candidate = _significant(frequency[part], series.amplitude[part, :, 0], len(frequency) / lines)
            if candidate is not None and not any(_overlaps(candidate, other) for other in found):
                found.append(candidate)
    return found


def _overlaps(one: PoleCandidate, other: PoleCandidate) -> bool:
    width = max(abs(one.damping), abs(other.damping)) * one.frequency_hz
    return abs(one.frequency_hz - other.frequency_hz) < 0.5 * width


def _significant(frequency: FloatArray, spectra: ComplexArray, windows: float) -> PoleCandidate | None:
    """The best pole of a window, None where it is not significant or lies in the outer quarters."""
    basis = ModalBasis.over(frequency, ModeForm.LOCAL, RESIDUAL_TERMS)
    scan = PoleScan.of(frequency_response(frequency, spectra), basis)
    quarter = 0.25 * (frequency[-1] - frequency[0])
    low, high = float(frequency[0] + quarter), float(frequency[-1] - quarter)
    line_hz = float(frequency[1] - frequency[0])
    best = scan.best_of(*grid_of_lines(low, high, line_hz, len(frequency)), low, high)
    rest, freedom = scan.rest((best,))
    added = scan.added_parameters()
    p_value = float(stats.f.sf(best.gain / added / max(rest / freedom, 1e-300), added, freedom))
    is_inside = low < best.frequency_hz < high
    return best if is_inside and p_value * len(frequency) * windows * 2 < SIGNIFICANCE else None


def grid_of_lines(low: float, high: float, line_hz: float, lines: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies and dampings of a scan, from a third of a line to a sixth of the window wide, of both signs."""
    half = np.geomspace(0.3 * line_hz, lines * line_hz / 6, 5)
    places = np.arange(low, high, 0.5 * line_hz)
    frequency, half_bandwidth = (one.ravel() for one in np.meshgrid(places, half, indexing="ij"))
    damping = half_bandwidth / frequency
    return np.concatenate([frequency, frequency]), np.concatenate([damping, -damping])


def _own_window(series: ResponseSeries, candidate: PoleCandidate) -> ModeSearch:
    """Search in a window that fits a candidate's bandwidth."""
    frequency = series.frequency_hz
    if candidate.damping < 0:
        text = f"the phase rises through {candidate.frequency_hz:.5g} Hz, as of a pole with negative damping"
        return ModeSearch((), (text,), None)
    line_hz = float(frequency[1] - frequency[0])
    half_bandwidth = candidate.damping * candidate.frequency_hz
    if half_bandwidth < NARROWEST_LINES * line_hz:
        return ModeSearch((), (f"a tone at {candidate.frequency_hz:.5g} Hz is narrower than the lines can show",), None)
    half = float(np.clip(HALF_BANDWIDTHS * half_bandwidth, LEAST_LINES * line_hz, MOST_LINES * line_hz))
    window = whitened(series.subset(np.abs(frequency - candidate.frequency_hz) <= half), candidate)
    low, high = max(candidate.frequency_hz - 0.8 * half, float(frequency[0])), candidate.frequency_hz + 0.8 * half
    return find_modes(
        window,
        form=ModeForm.LOCAL,
        residual_terms=RESIDUAL_TERMS,
        band_hz=(low, high),
        most=2 if _has_neighbour(window, candidate, low, high) else 1,
        is_noise_known=False,
    )


def whitened(window: ResponseSeries, candidate: PoleCandidate) -> ResponseSeries:
    """Channels mixed so that their noise is independent: the trackers of one image err together.

    The covariance is that of what the candidate leaves, shrunk towards its diagonal (Ledoit and Wolf 2004,
    doi:10.1016/S0047-259X(03)00096-4).
    """
    spectra = window.amplitude[:, :, 0]
    steps, channels = spectra.shape
    basis = ModalBasis.over(window.frequency_hz, ModeForm.LOCAL, RESIDUAL_TERMS)
    pole = np.array([candidate.frequency_hz]), np.array([candidate.damping])
    columns = basis.columns(window.frequency_hz, *pole)
    if channels == 1 or steps <= columns.shape[1] + 2:
        return window
    rest = spectra - columns @ np.linalg.lstsq(columns, spectra, rcond=None)[0]
    covariance = rest.T @ rest.conj() / (steps - columns.shape[1])
    shrink = min(1.0, channels / (steps - columns.shape[1]))
    covariance = (1 - shrink) * covariance + shrink * np.diag(np.diag(covariance).real)
    covariance += 1e-9 * np.trace(covariance).real / channels * np.eye(channels)
    mixed: ComplexArray = np.linalg.solve(np.linalg.cholesky(covariance), spectra.T).T.astype(np.complex128)
    return frequency_response(window.frequency_hz, mixed)


def _has_neighbour(window: ResponseSeries, candidate: PoleCandidate, low: float, high: float) -> bool:
    """Whether a second pole explains most of what one leaves: a close mode, not the shape of the noise."""
    scan = PoleScan.of(window, ModalBasis.over(window.frequency_hz, ModeForm.LOCAL, RESIDUAL_TERMS))
    one = (scan.refine(PoleCandidate(candidate.frequency_hz, candidate.damping, 0.0), (), low, high),)
    two = scan.refine_all((*one, scan.best(low, high, one)), low, high)
    first, second = two
    ratio = second.damping / first.damping if first.damping > 0 else 0.0
    is_mode = 1 / WIDEST_NEIGHBOUR < ratio < WIDEST_NEIGHBOUR
    apart = abs(second.frequency_hz - first.frequency_hz) > first.damping * first.frequency_hz
    return is_mode and apart and scan.rest(two)[0] < NEIGHBOUR_REST * scan.rest(one)[0]


def _is_same(one: Mode, other: Mode) -> bool:
    width = max(one.damping * one.frequency_hz, other.damping * other.frequency_hz)
    sd = np.hypot(one.sd_frequency_hz, other.sd_frequency_hz)
    return bool(abs(one.frequency_hz - other.frequency_hz) < max(SAME_MODE_BANDWIDTHS * width, 3 * sd))
