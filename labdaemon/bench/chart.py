"""The accuracy programme as a figure: errors of both methods, and ours against the bound."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np

from labdaemon.bench.accuracy import AccuracyResult
from labdaemon.bench.accuracy_text import PUBLISHED
from labdaemon.errors import UsageError

COLOURS = ("#0072b2", "#d55e00", "#009e73")


def figure_class() -> type[Any]:
    """Matplotlib's figure; asked for before anything is computed.

    Raises
    ------
    UsageError
        Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise UsageError("a figure needs matplotlib: pip install 'labdaemon[plot]'") from None
    return cast("type[Any]", Figure)


def draw(result: AccuracyResult, file: Path) -> None:
    """Draw the pooled case.

    Parameters
    ----------
    file
        PNG to write.
    """
    pooled = next(case for case in result.cases if case.case.pooled)
    figure = figure_class()(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    if pooled.published is not None:
        theirs = [pair for pair in pooled.published if np.isfinite(pair.a).all()]
        left.plot([p.true_mm for p in theirs], [p.error_mm for p in theirs], "x", color="0.5", label="published method")
    ours = [pair for pair in pooled.ours if pair.compared]
    left.plot([p.true_mm for p in ours], [p.error_mm for p in ours], ".", color=COLOURS[0], label="labdaemon")
    mean, _, within = PUBLISHED
    left.axhspan(-within, within, color="0.93", zorder=0, label=f"published: 95 % within {within} mm")
    left.axhline(mean, color="0.5", ls="--", lw=0.8, label=f"published: mean {mean} mm")
    left.set(xscale="log", xlabel="true semi-amplitude, mm", ylabel="error, mm")
    left.legend(fontsize=8)
    for colour, (diameter, bound) in zip(COLOURS, sorted(result.bounds.along_mm.items()), strict=False):
        mine = [pair for pair in ours if pair.diameter_mm == diameter]
        right.plot([p.true_mm for p in mine], [abs(p.error_mm) for p in mine], ".", color=colour, ms=4)
        right.plot(result.bounds.amplitude_mm, bound, color=colour, label=f"{diameter:g} mm dots: Cramér–Rao bound")
    right.set(xscale="log", yscale="log", xlabel="true semi-amplitude, mm", ylabel="|error|, mm (labdaemon)")
    right.set_ylim(1e-5, 0.1)
    right.legend(fontsize=8)
    for plot in (left, right):
        plot.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)
