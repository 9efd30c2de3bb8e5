"""Light that changed over the excitation's cycle although nothing states it: what the targets of a frame say together.

Over whole cycles under constant light a sinusoid spends the same time on both halves of its path, and so does any
motion with odd harmonics: the odd terms of the series of `waveform_series` are zero. A lamp that follows the excitation
gives them sizes up to 1, and the path's length is then wrong by some ten per cent. A second harmonic of the motion of
3 %, or 5.5 cycles taken for whole ones, gives less than 0.15; both change the amplitude by less than 1 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labdaemon.blur.phase.waveform_series import ORDERS
from labdaemon.blur.phase.window_evidence import WaveformEvidence
from labdaemon.flags import Flag

SHOWN = 50.0
"""Squared standard deviations by which the odd terms must explain a target better. Statistics: noise alone does not
reach it."""
LEAST = 0.2
"""Size of the first two odd terms, of the targets' median, below which amplitudes are wrong by less than about 1 %."""
PRIOR_SD = 0.5
"""Standard deviation of each term beforehand: what an image does not show stays near zero."""
SHARE = 0.5
"""Share of the targets that must show it: something in front of a target makes its smear uneven, too."""


def is_light_uneven(evidence: Sequence[WaveformEvidence]) -> bool:
    """Whether the targets of a frame exclude constant light over whole cycles.

    Parameters
    ----------
    evidence
        Of targets with long straight paths, over whole cycles.
    """
    sizes = [size for size in map(_odd_size, evidence) if size > 0]
    if len(sizes) <= SHARE * len(evidence) or not np.median(sizes) > LEAST:
        return False
    return len(evidence) > 1 or Flag.OCCLUDED not in evidence[0].flags


def _odd_size(one: WaveformEvidence) -> float:
    """Size of the first two odd terms; 0 where the image does not ask for any."""
    count = len(one.score)
    odd = range(0, ORDERS, 2)
    others = [index for index in range(count) if index not in odd]
    if not one.gain(range(count)) - one.gain(others) - len(odd) > SHOWN:
        return 0.0
    terms = np.linalg.solve(one.information / one.scale + np.eye(count) / PRIOR_SD**2, one.score / one.scale)
    return float(np.hypot(terms[0], terms[2]))
