"""Thresholds for blurs near the end of their label (``fit.label_edge``); sources as in ``settings``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LabelEdgeSettings:
    """Where a label ends, and when a fit of what is left is believed."""

    margin_px: float = 2.5
    """Distance from the end of the label that its own blur and the error of the outline fill. Trial."""
    sharp_margin_px: float = 2.0
    """The same in the sharp frame, where the residuals show what the margin misses. Trial."""
    iterations: int = 4
    """Fits under the mask of the last one's result. Trial: two are enough from a good start."""
    settled_px: float = 0.3
    """Change of a below which the mask stays. Trial: the margin covers it."""
    hopeless_chi2: float = 50.0
    """Mean squared residual of a first fit from which the target may not be there at all. Trial: speed."""
    first_scales: tuple[float, ...] = (1.15, 0.8, 1.6)
    """Lengths of the first path, over the guess. Trial: a longer path leaves less, but all of it is label."""
    holding_margin_px: float = 1.0
    """Paper that a blur needs around it, at least, not to reach the end of its label. Trial."""
    largest_ratio: float = 2.5
    """Length of a path, over the guess or the radius, beyond which a failed fit says nothing of the motion. Trial."""
    least_length: float = 0.5
    """Length of a path, in radii of the dot, that is possible whatever a failed fit says. Trial."""
    trial_lengths: tuple[float, ...] = (0.3, 0.55, 0.8, 1.05, 1.3, 1.55)
    """Lengths of the paths that are tried where every guess fails, in radii of the dot."""
    trial_directions: int = 8
    """Directions of each, evenly over half a turn."""
    trial_offset: float = 0.3
    """Distance of the places that are then tried, in radii of the dot."""
    followed_trials: int = 4
    """Best trials that are followed."""
    least_pixels: int = 60
    """Clear pixels that a trial needs to be compared."""
    max_contrast_change: float = 0.35
    """Largest relative difference of the ink's contrast from the sharp frame's, for a rough path. Trial."""
    least_explained: float = 0.75
    """Part of the variance that the best trial explains where the target is there at all. Trial: 0.89 to 1.0 of labels,
    0.4 to 0.7 of a card with spots."""
    max_sd_px: float = 0.1
    """Standard deviation of the amplitude above which what is left does not determine it. Trial."""
    max_sd_fraction: float = 0.005
    """The same as a part of the amplitude; the larger of the two counts. Trial: few pixels leave a bias."""


LABEL_EDGE = LabelEdgeSettings()
