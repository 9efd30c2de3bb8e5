"""The uncertainty of a page's results in words: how large it is, and what it contains."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from labdaemon.orbit_size import is_doubtful, size_mm
from labdaemon.report.accuracy import semi_amplitude_sd_mm

AT_REST = "at_rest"


def budget(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Sentences about all rows of `envelope.csv` of a page; empty where nothing was measured."""
    measured = [row for row in rows if size_mm(row) is not None]
    sure = [row for row in measured if not is_doubtful(row)]
    moving = [(size_mm(row) or 0.0, semi_amplitude_sd_mm(row)) for row in sure if AT_REST not in (row["flags"] or ())]
    sds = [(size, sd) for size, sd in moving if sd is not None and sd > 0 and size > 0]
    sentences = []
    if sds:
        values = [sd for _, sd in sds]
        share = 100 * statistics.median(sd / size for size, sd in sds)
        sentences.append(
            f"Amplitude: the standard deviation is {statistics.median(values):.4f} mm in the median and below "
            f"{float(np.quantile(values, 0.95)):.4f} mm for 95 % of {len(values)} readings without a flag, or "
            f"{share:.2g} % of the amplitude in the median. "
            "It contains photon and read noise, the texture of the label, focus, and the orientation of the cameras."
        )
    places = [row["sd_x_mm"] for row in sure if isinstance(row.get("sd_x_mm"), float)]
    if places:
        sentences.append(
            f"Position: {statistics.median(places):.3f} mm in the median. It contains the survey of the control "
            "targets, which shifts all targets together."
        )
    if measured and all(row.get("sd_y_mm") is None or row.get("sd_z_mm") is None for row in measured):
        sentences.append("One camera: motion out of its plane does not show, and has no number.")
    rest = sum(AT_REST in (row["flags"] or ()) for row in measured)
    if rest:
        sentences.append(
            f"{rest} readings are below the detection limit (at_rest): their amplitude is an estimate that is never "
            "negative, so that it is too large on average."
        )
    flags = Counter(flag for row in rows for flag in row["flags"] or () if flag != AT_REST)
    if flags:
        listed = ", ".join(f"{count} {flag}" for flag, count in flags.most_common())
        sentences.append(f"Readings with a flag: {listed}. A flag says that the number may be wrong beyond its sd.")
    return sentences
