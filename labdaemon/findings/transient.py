"""Steps that were captured before the structure had settled: the rest of the transient as a term of the model.

A mode that still changes by c per cycle has c/(2πζ) of its amplitude to come. The table's amplitude of that step may be
wrong by as much, as far as the mode is concerned, so this joins the step's own amplitude error: the fit then leans on
the steps that had settled.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from labdaemon.findings.next_frequency import UNKNOWN_DAMPING, remaining_transient
from labdaemon.findings.response import FloatArray, ResponseSeries


def with_transients(
    series: ResponseSeries, change_per_cycle: FloatArray, damping: float, factor: float = UNKNOWN_DAMPING
) -> ResponseSeries:
    """The series with what may remain of the transients in the sd of each step's table amplitude.

    Parameters
    ----------
    change_per_cycle
        (K,) relative change of the response from cycle to cycle when the capture was taken; 0 where it had settled.
    damping
        ζ as it is known.
    factor
        By which it may be too large.
    """
    remaining = np.abs(change_per_cycle) * factor / (2 * np.pi * damping)
    return replace(series, sd_table=np.hypot(series.sd_table, remaining))


def settling_hold_s(
    change_per_cycle: float, damping: float, frequency_hz: float, sd_relative: float, factor: float = UNKNOWN_DAMPING
) -> float:
    """Time after which what remains of a transient is below a third of the amplitude's standard deviation, seconds.

    Parameters
    ----------
    change_per_cycle
        Relative change of the response from cycle to cycle now, or the limit below which it is known to be.
    damping
        ζ as it is known.
    frequency_hz
        Of the mode that rings down.
    sd_relative
        Standard deviation of the amplitude over the amplitude.
    factor
        By which the damping may be too large.
    """
    ratio = remaining_transient(change_per_cycle, damping, factor) / (sd_relative / 3)
    return max(math.log(ratio), 0.0) / (2 * math.pi * damping * frequency_hz)
