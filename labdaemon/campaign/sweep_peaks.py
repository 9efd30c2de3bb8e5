"""Natural frequencies from a sweep that has ended: what a later dwell ``at = "peaks"`` visits.

The gauge on the structure and the one on the table give a frequency response function (FRF), one value a step. Without
a gauge on the structure the envelopes of the targets that moved most are taken. Where the fit finds a mode between two
steps, the dwell goes there: a sweep of wide steps need not have met it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from labdaemon.envelope import TargetEnvelope
from labdaemon.events import GaugeMotion, ModeEstimate
from labdaemon.findings.envelope_series import LARGEST_PHASE_SD, MeasuredStep, envelope_series
from labdaemon.findings.find_modes import LEAST_STEPS, find_modes

if TYPE_CHECKING:
    from labdaemon.findings.response import FloatArray

MOST_TARGETS = 4
"""Targets whose envelopes are fitted; more of them cost minutes, and a sweep only has to say where to look."""


def response_motion(gauges: Sequence[GaugeMotion]) -> GaugeMotion | None:
    """What a gauge on the structure saw; None where there is none, or it saw nothing."""
    found = [one for one in gauges if one.role == "response" and one.amplitude_mm and one.sd_amplitude_mm]
    return found[0] if found else None


def modes_of_sweep(
    steps: Sequence[MeasuredStep], gauges: Mapping[int, GaugeMotion], band_hz: tuple[float, float]
) -> tuple[tuple[ModeEstimate, ...], str]:
    """Modes in the response of a sweep, and what they were found in.

    Parameters
    ----------
    steps
        Envelopes with their excitation.
    gauges
        What a gauge on the structure saw, by the place in `steps`; empty without such a gauge.
    band_hz
        Where natural frequencies may lie.
    """
    found: tuple[tuple[ModeEstimate, ...], str] = ((), "")
    if len(gauges) >= LEAST_STEPS:
        series = _gauge_steps([(steps[place], motion) for place, motion in gauges.items()])
        found = _modes_in(series, "the gauge's frequency response", band_hz)
    if not found[0]:  # no gauge, or one that sits where nothing moves
        names = _moving_most(steps)
        series = [
            replace(one, targets={name: one.targets[name] for name in names & one.targets.keys()}) for one in steps
        ]
        found = _modes_in(series, "the envelopes", band_hz)
    return found


def _modes_in(
    steps: Sequence[MeasuredStep], source: str, band_hz: tuple[float, float]
) -> tuple[tuple[ModeEstimate, ...], str]:
    if len({step.frequency_hz for step in steps}) < LEAST_STEPS:
        return (), f"{len(steps)} steps of the sweep were measured, at least {LEAST_STEPS} frequencies are needed"
    search = find_modes(envelope_series(steps).series, band_hz=band_hz)
    modes = tuple(
        ModeEstimate(
            frequency_hz=mode.frequency_hz,
            sd_frequency_hz=mode.sd_frequency_hz,
            damping=mode.damping,
            sd_damping=mode.sd_damping,
        )
        for mode in search.modes
    )
    count = f"{len(modes)} modes" if len(modes) != 1 else "1 mode"
    why = "" if modes or not search.reasons else f": {search.reasons[0]}"
    return modes, f"{count} in {source} at {len(steps)} steps{why}"


def _gauge_steps(seen: Sequence[tuple[MeasuredStep, GaugeMotion]]) -> list[MeasuredStep]:
    """Steps with the gauge as their only target, moving along x: with its phase where both gauges know theirs."""
    is_signed = all(
        sd is not None and sd < LARGEST_PHASE_SD
        for step, motion in seen
        for sd in (step.sd_phase_rad, motion.sd_phase_rad)
    )
    return [
        replace(step, targets={motion.gauge: _as_target(motion, is_signed=is_signed)}, is_signed=is_signed)
        for step, motion in seen
    ]


def _as_target(motion: GaugeMotion, *, is_signed: bool) -> TargetEnvelope:
    amplitude_mm, sd_mm = motion.amplitude_mm or 0.0, motion.sd_amplitude_mm or 0.0
    phasor, sd_phase_rad = complex(amplitude_mm), 0.0
    if is_signed:
        phasor = amplitude_mm * np.exp(1j * (motion.phase_rad or 0.0))
        sd_phase_rad = motion.sd_phase_rad or 0.0
    sd = np.hypot(sd_mm, amplitude_mm * sd_phase_rad)
    return TargetEnvelope(
        motion.gauge, _along_x(np.nan), _along_x(phasor.real), _along_x(phasor.imag), _along_x(np.nan), _along_x(sd),
        _along_x(sd),
    )  # fmt: skip


def _along_x(value: float) -> FloatArray:
    return np.array([value, np.nan, np.nan])


def _moving_most(steps: Sequence[MeasuredStep]) -> set[str]:
    """Names of the targets whose responses without a flag are the largest in sum."""
    ratio: dict[str, list[float]] = {}
    for step in steps:
        for name, one in step.targets.items():
            if not one.flags:
                ratio.setdefault(name, []).append(one.amplitude_mm / step.table_mm)
    return set(sorted(ratio, key=lambda name: -float(np.sum(ratio[name])))[:MOST_TARGETS])
