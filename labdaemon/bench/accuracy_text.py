"""The accuracy programme's results as lines for a reader and as values for a machine."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from labdaemon.bench.accuracy import AccuracyResult, CaseResult
from labdaemon.bench.cases import SIGN_CYCLES
from labdaemon.bench.pairs import MotionComparison, sign_is_right
from labdaemon.bench.statistics import SEEN_MM, ErrorStatistics, figures, median_phase_error_deg

PUBLISHED = (-0.115, 0.158, 0.38)
"""Mean error, its standard deviation, and what 95 % lie within, mm: McCarthy, Chandler and Palmeri 2016, Fig. 13."""

BANDS_MM = ((0.1, SEEN_MM), (SEEN_MM, 1.0), (1.0, 3.0), (3.0, 12.0))

_HEAD = f"{'':38}{'n':>5}{'unflagged':>10}{'mean mm':>10}{'sd mm':>9}{'95 % mm':>9}{'pulls':>7}"


def lines(result: AccuracyResult) -> list[str]:
    """What the command prints."""
    seeds = ", ".join(map(str, result.seeds))
    text = [f"D80, 24 mm at f/32, 1 m; control surveyed to 0.05 mm; seeds {seeds}", ""]
    pooled = next((case for case in result.cases if case.case.pooled), None)
    if pooled is not None:
        text += _fig13(pooled, result)
        text += _bands(pooled.ours, result)
    text += ["", _HEAD, *(_row(case) for case in result.cases), ""]
    text += [line for case in result.cases for line in _special(case)]
    gaussian = next((case for case in result.cases if case.case.key == "gaussian"), None)
    if pooled is not None and gaussian is not None:
        text.append(_optics(pooled, gaussian))
    return text


def _fig13(pooled: CaseResult, result: AccuracyResult) -> list[str]:
    ours = figures(pooled.ours, result.bounds)
    text = [f"Error of the semi-amplitude, {pooled.case.title}, {ours.targets} targets of 0.1 to 12 mm"]
    text.append(f"{'':38}{'mean mm':>10}{'sd mm':>9}{'95 % within mm':>16}")
    text.append(f"{'published (Fig. 13)':38}{PUBLISHED[0]:10.3f}{PUBLISHED[1]:9.3f}{PUBLISHED[2]:16.3f}")
    if pooled.published is None:
        text.append(f"{'published method, on these frames':38}{'not available':>35}")
    else:
        theirs = figures(pooled.published)
        missing = theirs.targets - theirs.compared
        note = f"   ({missing} of {theirs.targets} flagged or not measured)" if missing else ""
        text.append(
            f"{'published method, on these frames':38}{theirs.mean_mm:10.4f}{theirs.sd_mm:9.4f}"
            f"{theirs.p95_mm:16.4f}{note}"
        )
    text.append(f"{'labdaemon':38}{ours.mean_mm:10.4f}{ours.sd_mm:9.4f}{ours.p95_mm:16.4f}")
    text.append("")
    text.append(
        f"{PUBLISHED[2] / ours.p95_mm:.0f} times finer than published (goal: 50 times, 0.0076 mm); "
        f"at the Cramér–Rao bound 95 % of these would lie within {ours.ideal_p95_mm:.4f} mm"
    )
    text.append(
        f"above {SEEN_MM} mm: rms error {ours.bound_ratio:.2f} x the Cramér–Rao bound (goal 1.5), which is "
        f"{ours.bound_mm * 1e3:.1f} µm rms"
    )
    text.append(
        f"direction above {SEEN_MM} mm (1 px): median {ours.direction_p50_deg:.3f}°, 95 % within "
        f"{ours.direction_p95_deg:.2f}° (goal 0.2°; at the bound {ours.ideal_direction_p95_deg:.2f}°); "
        f"rms {ours.direction_ratio:.2f} x its bound, which is {ours.direction_bound_deg:.3f}° rms"
    )
    return text


def _bands(pairs: list[MotionComparison], result: AccuracyResult) -> list[str]:
    columns = f"{'mean µm':>10}{'sd µm':>9}{'95 % µm':>9}{'bound µm':>10}{'ratio':>7}{'pulls':>7}"
    text = ["", f"{'by amplitude and size':38}{'n':>5}{columns}"]
    groups = [(f"{low:g} to {high:g} mm", [p for p in pairs if low <= p.true_mm < high]) for low, high in BANDS_MM]
    sizes = sorted({pair.diameter_mm for pair in pairs})
    groups += [(f"{size:g} mm dots", [p for p in pairs if p.diameter_mm == size]) for size in sizes]
    for name, chosen in groups:
        f = figures(chosen, result.bounds)
        text.append(
            f"{name:38}{f.compared:5d}{f.mean_mm * 1e3:10.2f}{f.sd_mm * 1e3:9.2f}{f.p95_mm * 1e3:9.2f}"
            f"{f.bound_mm * 1e3:10.2f}{f.bound_ratio:7.2f}{f.pull_rms:7.2f}"
        )
    return text


def _row(case: CaseResult) -> str:
    f = figures(case.ours)
    share = f"{100.0 * f.compared / f.targets:.1f} %" if f.targets else "-"
    pulls = "-" if case.case.phased else f"{f.pull_rms:.2f}"
    numbers = f"{f.mean_mm:10.4f}{f.sd_mm:9.4f}{f.p95_mm:9.4f}{pulls:>7}"
    return f"{case.case.title:38}{f.targets:5d}{share:>10}{numbers}"


def _special(case: CaseResult) -> list[str]:
    f = figures(case.ours)
    if case.case.key == "orbit":
        seen = figures([pair for pair in case.ours if 0.5 * pair.true_mm >= 0.15])
        return [f"Minor axis of orbits where it is 0.15 mm or more: 95 % within {seen.minor_p95_mm:.4f} mm (goal 0.02)"]
    if case.case.key == "phase":
        phase = median_phase_error_deg(case.ours)
        return [f"Phase at 0.8 mm, 5.5 cycles, two captures 90° apart: median error {phase:.2f}° (goal 2°)"]
    if case.case.key == "part-known":
        return [f"5.37 cycles, window known: 95 % within {f.p95_mm:.4f} mm"]
    if case.case.key == "part-unknown":
        said = sum("part_cycles" in pair.flags for pair in case.ours)
        return [
            f"5.37 cycles, phase unknown: {said} of {f.targets} flagged part_cycles, 95 % within "
            f"{100.0 * f.relative_p95:.1f} % (goal 3 %)"
        ]
    if case.case.key == "signs":
        stated = [pair for pair in case.ours if pair.sign]
        wrong = sum(not sign_is_right(pair, SIGN_CYCLES) for pair in stated)
        return [
            f"Signs from one exposure of 5.5 cycles, 0.2 to 3 mm at any phase: {len(stated)} of {f.targets} stated, "
            f"{wrong} of them wrong"
        ]
    return []


def _optics(pooled: CaseResult, gaussian: CaseResult) -> str:
    """How much diffraction costs: the same motions through either."""
    airy, round_ = (figures([pair for pair in case.ours if pair.true_mm >= SEEN_MM]) for case in (pooled, gaussian))
    ratio = math.hypot(airy.mean_mm, airy.sd_mm) / math.hypot(round_.mean_mm, round_.sd_mm)
    return f"Diffraction at f/32 against Gaussian optics: rms error {ratio:.2f} x (goal 1.5)"


def document(result: AccuracyResult) -> dict[str, Any]:
    """The same for a machine: figures of every case, and every error."""
    return {
        "seeds": list(result.seeds),
        "published": dict(zip(("mean_mm", "sd_mm", "p95_mm"), PUBLISHED, strict=True)),
        "bound_mm": {
            "amplitude_mm": result.bounds.amplitude_mm.tolist(),
            **{f"{diameter:g}": sd.tolist() for diameter, sd in result.bounds.along_mm.items()},
        },
        "cases": {case.case.key: _case_document(case, result) for case in result.cases},
    }


def _case_document(case: CaseResult, result: AccuracyResult) -> dict[str, Any]:
    bounds = result.bounds if case.case.pooled else None
    made: dict[str, Any] = {
        "title": case.case.title,
        "figures": _plain(figures(case.ours, bounds)),
        "targets": [_pair_document(pair) for pair in case.ours],
    }
    if case.published is not None:
        made["published_method"] = {
            "figures": _plain(figures(case.published)),
            "targets": [_pair_document(pair) for pair in case.published],
        }
    if case.case.key == "phase":
        made["median_phase_error_deg"] = median_phase_error_deg(case.ours)
    return made


def _pair_document(pair: MotionComparison) -> dict[str, Any]:
    measured = bool(pair.compared)
    return {
        "diameter_mm": pair.diameter_mm,
        "true_mm": pair.true_mm,
        "error_mm": pair.error_mm if measured else None,
        "sd_mm": pair.sd_mm if measured else None,
        "flags": sorted(pair.flags),
    }


def _plain(f: ErrorStatistics) -> dict[str, float | int | None]:
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(f).items()}
