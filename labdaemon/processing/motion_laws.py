"""Which gauge's harmonics a target's motion has: those of the gauge that the rig file says stands for it, else unknown.

A structure passes each harmonic on with a factor of its own, so that a gauge's waveform is a target's only where both
move together. The rig file says so (`stands_for` of a ``[[gauge]]``), since nothing in the images does. For all other
targets a harmonic that some gauge sees is an error of unknown phase, and widens the standard deviation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

import numpy as np

from labdaemon.blur import Measurement, MotionHarmonics, with_relative_sd
from labdaemon.events import GaugeMotion

ORDERS = (2, 3, 4, 5)
SIGNIFICANT_SDS = 4.5
"""A harmonic beyond so many of its standard deviations is none of the noise: one record in 25 000 without any."""
NEGLIGIBLE = 3e-4
"""Harmonics, over the fundamental, that change an amplitude by less than 0.01 %."""
AMPLITUDE_EFFECT = 0.35
"""Relative error of an amplitude over the harmonic that was left out, at worst (5 % of the third: 1.7 %)."""
LARGEST = 0.5
"""Harmonics beyond this are no waveform of a motion at one frequency, whatever the gauge sees."""


@dataclass(frozen=True, slots=True)
class MotionLaws:
    """What gauges say of the targets' waveforms in a capture, or in the captures of a group.

    Attributes
    ----------
    rules
        Harmonics, and the names or patterns of the targets that have them; the first that fits a target counts.
    unknown
        Largest harmonic content that a gauge saw, over the fundamental: what all other targets may have.
    """

    rules: tuple[tuple[tuple[str, ...], MotionHarmonics], ...] = field(default=())
    unknown: float = 0.0

    def of(self, target: str) -> MotionHarmonics | None:
        """A target's harmonics, None where no gauge stands for it."""
        for patterns, harmonics in self.rules:
            if any(fnmatchcase(target, pattern) for pattern in patterns):
                return harmonics
        return None

    def with_unknown(self, measurement: Measurement) -> Measurement:
        """A measurement with what its target's unknown harmonics add to the covariance."""
        if self.unknown <= 0 or self.of(measurement.target) is not None:
            return measurement
        return with_relative_sd(measurement, AMPLITUDE_EFFECT * self.unknown)


def motion_laws(stands_for: Mapping[str, Sequence[str]], captures: Sequence[Mapping[str, GaugeMotion]]) -> MotionLaws:
    """Waveforms by what the gauges saw.

    Parameters
    ----------
    stands_for
        Names or patterns of targets by name of the gauge, in the order of the rig file; ``("*",)`` for all.
    captures
        What each gauge saw, by its name, in each capture of the group.
    """
    rules = []
    for gauge, patterns in stands_for.items():
        seen = [harmonics_of(one[gauge]) for one in captures if gauge in one]
        known = [one for one in seen if one is not None]
        if known and len(known) == len(captures):
            rules.append((tuple(patterns), _mean(known)))
    unknown = max((_significant(motion) for one in captures for motion in one.values()), default=0.0)
    return MotionLaws(tuple(rules), unknown if unknown > NEGLIGIBLE else 0.0)


def harmonics_of(motion: GaugeMotion) -> MotionHarmonics | None:
    """A gauge's harmonics over its fundamental; None where it does not show the second and third, or hardly moves."""
    size = motion.amplitude_mm
    if size is None or not size > 0 or motion.h2_mm is None or motion.h3_mm is None:
        return None
    cosine, sine, sds = [], [], []
    for order in ORDERS:
        amplitude, sd, phase, sd_phase = _harmonic(motion, order)
        if amplitude is None or sd is None:
            break
        ratio, sd_ratio = amplitude / size, sd / size
        if phase is None:  # within its noise
            cosine.append(0.0)
            sine.append(0.0)
            sds.append(math.hypot(ratio, sd_ratio))
        else:
            cosine.append(ratio * math.cos(phase))
            sine.append(ratio * math.sin(phase))
            sds.append(max(sd_ratio, ratio * (sd_phase or 0.0)))
    if not math.hypot(*cosine, *sine) < LARGEST or max(sds) > LARGEST:
        return None
    return MotionHarmonics(tuple(cosine), tuple(sine), tuple(sds))


def _harmonic(motion: GaugeMotion, order: int) -> tuple[float | None, float | None, float | None, float | None]:
    """Amplitude (mm), its sd, phase and its sd."""
    values = [
        getattr(motion, name.format(order)) for name in ("h{}_mm", "sd_h{}_mm", "h{}_phase_rad", "sd_h{}_phase_rad")
    ]
    return values[0], values[1], values[2], values[3]


def _significant(motion: GaugeMotion) -> float:
    """Root sum of squares of the harmonics that are none of the noise, over the fundamental."""
    if motion.amplitude_mm is None or not motion.amplitude_mm > SIGNIFICANT_SDS * (motion.sd_amplitude_mm or 0.0):
        return 0.0
    pairs = [_harmonic(motion, order)[:2] for order in ORDERS]
    seen = [size for size, sd in pairs if size is not None and sd is not None and size > SIGNIFICANT_SDS * sd]
    return min(math.hypot(*seen) / motion.amplitude_mm, LARGEST) if seen else 0.0


def _mean(each: Sequence[MotionHarmonics]) -> MotionHarmonics:
    """Mean over the captures of a group; their scatter counts where it exceeds the standard deviations."""
    count = min(len(one.sd) for one in each)
    parts = np.array([[one.cosine[:count], one.sine[:count], one.sd[:count]] for one in each])
    cosine, sine = parts[:, 0].mean(axis=0), parts[:, 1].mean(axis=0)
    own = np.sqrt(np.mean(parts[:, 2] ** 2, axis=0) / len(each))
    scatter = np.sqrt(np.mean((parts[:, :2] - parts[:, :2].mean(axis=0)) ** 2, axis=0)).max(axis=0)
    sd = np.maximum(own, scatter)
    lists: list[list[float]] = [values.tolist() for values in (cosine, sine, sd)]
    return MotionHarmonics(tuple(lists[0]), tuple(lists[1]), tuple(lists[2]))
