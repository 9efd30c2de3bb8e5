"""The flags of a measurement: statements about one target, in result files and events.

A target that cannot be measured keeps its row with empty numbers and a flag; one that can must come without.
"""

from __future__ import annotations

from enum import StrEnum


class Flag(StrEnum):
    """What a result file says about a target, in addition to its numbers."""

    NOT_FOUND = "not_found"
    """The target could not be located in the frame."""
    AT_REST = "at_rest"
    """Below the detection limit; the estimate and its standard deviation stay."""
    SATURATED = "saturated"
    """Too many pixels at white level for what is left to determine the motion."""
    OCCLUDED = "occluded"
    """Something stands in front of the target."""
    PAPER_EDGE = "paper_edge"
    """The smear reaches the edge of its white paper."""
    POOR_FIT = "poor_fit"
    """The residuals are larger than noise: the motion is not what the model says."""
    AMBIGUOUS = "ambiguous"
    """Ends or orbit not settled between cameras; the better solution is given."""
    PART_CYCLES = "part_cycles"
    """More than 0.05 cycles from whole, as stated or as the frame's targets show together, with the phase unknown."""
    UNDETERMINED = "undetermined"
    """A component that the image cannot show: the texture has no structure along it (aperture problem)."""
    MIXED_MOTION = "mixed_motion"
    """A patch of two motions: no single number describes it."""
    CAMERA_MOVED = "camera_moved"
    """The frame's control targets moved: camera shake, not structure."""
    LIGHT_MISMATCH = "light_mismatch"
    """The frame's light was not the code that was stated."""
    CONTRADICTS_GROUP = "contradicts_group"
    """Members of a group differ beyond their standard deviations: they do not repeat one motion."""
