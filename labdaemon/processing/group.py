"""Captures of one group: whether their windows hold phase."""

from __future__ import annotations

from labdaemon.blur import MEASURE, ExposureWindow


def is_part_cycle(window: ExposureWindow) -> bool:
    """Whether an exposure under constant light is no whole number of cycles."""
    return window.light is None and window.fraction > MEASURE.part_cycle_limit


def holds_phase(window: ExposureWindow) -> bool:
    """Whether an exposure shows which way a point moved: coded light, or part cycles from a known phase."""
    return window.is_coded or (window.phase_rad is not None and is_part_cycle(window))
