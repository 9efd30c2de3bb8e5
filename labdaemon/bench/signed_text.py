"""The results of signed motions as lines for a reader and as values for a machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from labdaemon.bench.signed import SignedComparison, SignedResult

LARGE_PX = 2.5
"""Motion in the image from which no target of two cameras may stay ambiguous."""

_NORMAL_MEDIAN = 0.6745


def signed_lines(results: Sequence[SignedResult]) -> list[str]:
    """What the command prints."""
    text = ["Signed motions: lamp rise 100 µs, D80, texture 0.4 %"]
    text += [_case_line(result) for result in results if result.targets]
    twins = [one for result in results if result.case.codes for one in result.targets]
    wrong = sum(one.is_wrong and one.unflagged for one in twins)
    text.append(f"Twins: {wrong} wrong without a flag of {len(twins)} targets under coded light (goal 0 in 500)")
    return text


def signed_document(results: Sequence[SignedResult]) -> dict[str, Any]:
    """The same for a machine."""
    return {
        result.case.key: {"title": result.case.title, "line": line, "targets": len(result.targets)}
        for result, line in zip(results, signed_lines(results)[1:], strict=False)
    }


def _case_line(result: SignedResult) -> str:
    return _image_line(result) if np.isfinite(result.targets[0].bound_mm) else _space_line(result)


def _image_line(result: SignedResult) -> str:
    every = result.targets
    chosen = [one for one in every if one.unflagged and not one.is_wrong]
    if not chosen:
        return f"{result.case.title}: none of {len(every)} without a flag"
    if not result.case.codes:
        ratio = _rms([one.vector_error_mm / one.bound_mm for one in chosen])
        bound = _rms([one.bound_mm for one in chosen])
        p95 = np.percentile([one.vector_error_mm for one in chosen], 95)
        return (
            f"{result.case.title}: {len(chosen)} of {len(every)} unflagged, signed vectors 95 % within "
            f"{p95:.3f} mm, rms {ratio:.2f} x the bound (goal 1.25), which is {bound:.3f} mm rms; "
            f"pulls {_pulls(chosen):.2f}"
        )
    sd = float(np.median([one.sd_phase_deg for one in chosen]))
    found = float(np.median([abs(one.phase_error_deg) for one in chosen])) / _NORMAL_MEDIAN
    bound = float(np.median([one.bound_phase_deg for one in chosen]))
    ratio = _rms([one.phase_error_deg / one.bound_phase_deg for one in chosen])
    amplitude = np.percentile([abs(one.amplitude_error_mm) for one in chosen], 95)
    goal = f"; goal {result.case.goal_deg:g}°" if np.isfinite(result.case.goal_deg) else ""
    return (
        f"{result.case.title}: {len(chosen)} of {len(every)} unflagged, phase sd {sd:.2f}° stated, {found:.2f}° found "
        f"(medians{goal}), bound {bound:.2f}°, {ratio:.2f} x the bound (goal 1.3); amplitude "
        f"95 % within {amplitude:.4f} mm (goal 0.006); pulls {_pulls(chosen):.2f}"
    )


def _space_line(result: SignedResult) -> str:
    every = result.targets
    chosen = [one for one in every if one.unflagged]
    large = [one for one in every if one.true_px >= LARGE_PX]
    ambiguous = sum("ambiguous" in one.flags for one in large)
    error = np.percentile([one.vector_error_mm for one in chosen], 95) if chosen else float("nan")
    return (
        f"{result.case.title}: {len(chosen)} of {len(every)} unflagged, signed vectors 95 % within {error:.3f} mm "
        f"(goal 0.05); {ambiguous} of {len(large)} above {LARGE_PX:g} px ambiguous (goal 0); pulls {_pulls(chosen):.2f}"
    )


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _pulls(chosen: Sequence[SignedComparison]) -> float:
    return _rms([pull for one in chosen for pull in one.pulls]) if chosen else float("nan")
