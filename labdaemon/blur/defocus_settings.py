"""Settings of the extra blur of a frame, each with its unit and its source."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DefocusSettings:
    """Prior knowledge of the extra variance of a frame (``smear.defocus``)."""

    dot_sd_px2: float = 0.3
    """Prior standard deviation for a dot when no control target measures it. Trial: focus drifts of real lenses."""
    patch_sd_px2: float = 1e-3
    """The same for a textured patch, whose own details cannot be separated from defocus."""
    common_error_sd_px2: float = 0.002
    """Error that all control targets of a frame share (interpolation between the sharp frame's pixels). Trial."""
    min_scatter_px2: float = 0.005
    """Smallest scatter of the moving targets' own values: fewer digits are never known. Trial."""
    anisotropy_fraction: float = 0.15
    """Standard deviation of the extra blur's anisotropy, in parts of its bound. Trial, on real frames. On drawn dots of
    1.2 and 1.8 px an rms difference of 15 % between the blur along and across gives pulls of 0.8 to 0.9, 30 % 1.8 to
    2.3."""
    sharpness_frequency: float = 0.15
    """Spatial frequency, cycles per pixel, at which lens blurs are compared: where a dot's edge shows."""


DEFOCUS = DefocusSettings()
