"""What the windows of captures say: whether they hold phase, and whether they are known well enough."""

from __future__ import annotations

from labdaemon.blur import MEASURE, ExposureWindow


def is_part_cycle(window: ExposureWindow) -> bool:
    """Whether an exposure under constant light is no whole number of cycles."""
    return window.light is None and window.fraction > MEASURE.part_cycle_limit


def holds_phase(window: ExposureWindow) -> bool:
    """Whether an exposure shows which way a point moved: coded light, or part cycles from a known phase."""
    return window.is_coded or (window.phase_rad is not None and is_part_cycle(window))


def is_cycle_count_unknown(window: ExposureWindow | None) -> bool:
    """Whether the part of a cycle in an exposure under constant light is unknown, and with it the model of the blur."""
    if window is None:
        return True
    sd_cycles = window.frequency_hz * window.sd_exposure_s
    return window.light is None and window.phase_rad is None and sd_cycles > MEASURE.part_cycle_limit
