"""A third harmonic of the motion without a gauge: what the residuals of several targets show of it.

d = v·(sin θ + c sin 3θ + s cos 3θ) changes the blur over whole cycles by −c z J3(z) to first order (`waveform_series`):
the ends of the path, where the target dwells, move. Every long straight path shows its own c. A structure passes the
harmonic on with a factor for each point, so that the values differ between targets; their mean and their scatter are
what is known of the others. The quadrature part s shows by its square only, and so does its effect on the amplitude,
which is at most half of s².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.window_evidence import WaveformEvidence

SHOWN = 30.0
"""Sum of squares of the harmonics over their sd, beyond its expectation, from which there are some. Statistics: noise
alone reaches it once in a million."""
LEAST = 0.004
"""Harmonic over the fundamental below which the amplitude changes by less than 0.15 %, as by a model's other errors."""
LARGEST = 0.25
"""Harmonic over the fundamental beyond which the residuals are no harmonic's."""
QUADRATURE_EFFECT = 0.5
"""Relative error of the amplitude over the square of the quadrature part, at most."""


@dataclass(frozen=True, slots=True)
class ThirdHarmonic:
    """Third harmonic of the targets of a frame, over their fundamental.

    Attributes
    ----------
    own
        By name of the target: its in-phase part c and standard deviation.
    mean, scatter
        Of all targets; the scatter is the standard deviation of another target's c about the mean.
    gain
        By how many squared standard deviations it explains the images better.
    """

    own: dict[str, tuple[float, float]]
    mean: float
    scatter: float
    gain: float

    def of(self, target: str) -> MotionHarmonics:
        """One target's harmonics: its own, drawn to the mean by how well each is known."""
        mean, sd = self.mean, self.scatter
        if target in self.own:
            value, own_sd = self.own[target]
            weight = own_sd**-2 / (own_sd**-2 + self.scatter**-2)
            mean, sd = mean + weight * (value - mean), (own_sd**-2 + self.scatter**-2) ** -0.5
        return MotionHarmonics((0.0, mean), (0.0, 0.0), (0.0, sd))

    @property
    def relative_sd(self) -> float:
        """Standard deviation of every amplitude, over the amplitude, because of the quadrature part."""
        return QUADRATURE_EFFECT * (self.mean**2 + self.scatter**2)


def third_harmonic(evidence: Sequence[WaveformEvidence]) -> ThirdHarmonic | None:
    """The harmonic that several targets show; None where they show none.

    Parameters
    ----------
    evidence
        Of targets with long straight paths, over whole cycles.
    """
    if not evidence:
        return None
    information = np.array([one.information[-1, -1] / one.scale for one in evidence])
    values = np.array([one.score[-1] / one.information[-1, -1] for one in evidence])
    sds = information**-0.5
    gain = float(np.sum(values**2 * information))
    mean, scatter = mean_and_scatter(values, sds)
    if gain - len(values) < SHOWN or np.hypot(mean, scatter) < LEAST or np.abs(values).max() > LARGEST:
        return None
    names = [one.frame_set.sharp.name for one in evidence]
    own = {name: (float(c), float(sd)) for name, c, sd in zip(names, values, sds, strict=True)}
    return ThirdHarmonic(own, mean, scatter, gain)


def mean_and_scatter(values: FloatArray, sds: FloatArray) -> tuple[float, float]:
    """Mean over targets, and the standard deviation of one more about it.

    By moments (DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2). A single target says nothing of the
    others: their harmonics may then be as large as its own.
    """
    weight = sds**-2
    mean = float(weight @ values / weight.sum())
    excess = float(weight @ (values - mean) ** 2) - (len(values) - 1)
    between = max(excess / float(weight.sum() - (weight @ weight) / weight.sum()), 0.0) if len(values) > 1 else mean**2
    total = 1 / (sds**2 + between)
    mean = float(total @ values / total.sum())
    return mean, float(np.sqrt(between + 1 / total.sum()))
