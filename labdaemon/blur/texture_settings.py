"""Thresholds of textured patches; the sources are those of ``settings``, to which this page belongs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TextureSettings:
    """Textured patches: noise of the sharp frame, directions without texture, two motions (``fit.texture``)."""

    max_clipped: float = 0.005
    """Share of a sharp patch at white level from which it is `saturated`: the template is unknown there. Trial: 2 %
    cost 4 % of the amplitude, 25 % a quarter."""
    smoothing_px: float = 1.0
    """Smoothing before the gradient is taken: it removes most of the noise, and aliases of oblique stripes. Trial."""
    structure_sds: float = 8.0
    """Structure along a direction, in standard deviations of noise alone, from which it counts. Trial: less leaves
    sds of pixels, and a fit that is far from linear in them."""
    min_relative_gradient: float = 0.04
    """The same over the strongest direction's gradient: less is light, dirt and interpolation. Trial."""
    smoothing_bins: float = 2.0
    """Smoothing of a texture's power over neighbouring spatial frequencies, in steps of the transform. Trial."""
    twin_scale: float = 2.0
    """Divisor of differences of cost between twins: the texture's power is estimated from the patch itself. Trial:
    without it wrong twins of coarse textures (details of 4 px) led by up to 13, four of 22."""
    iterations: int = 25
    """Most steps of the fit."""
    frame_iterations: int = 8
    """The same through windows and under coded light, from a converged fit by least squares."""
    last_step_sd: float = 0.03
    """Step, in standard deviations, after which the fit stops."""
    rest_start_px2: float = 2.0
    """Motion of the first fit, as a², below which rest is tried as a start as well: noise may have made it. Trial."""
    rest_evidence: float = 13.0
    """Twice the log likelihood by which a path must exceed rest. Statistics: 0.15 % for two degrees of freedom."""
    extra_blur_sd_px2: float = 0.03
    """Prior standard deviation of what a frame loses in sharpness, the same in all directions. It shows across a
    straight path. Real one-second exposures: 0.05 px² on average."""
    min_share: float = 0.05
    """Smallest part of a direction's normal matrix that counts as information; the rest is noise. Numerics."""
    mixed_sds: float = 5.0
    """Difference of a part's squared amplitude, in its sd, from which motions differ. Statistics: 15 parts."""
    mixed_fraction: float = 0.3
    """The same over the squared amplitude of the whole. Trial: rotation about an end differs by less."""
    mixed_least_px2: float = 0.3
    """The same near rest. Trial: changes of focus."""
    part_share: float = 0.02
    """Part of a small region's normal matrix, noise subtracted, from which a direction counts. Numerics."""


TEXTURE = TextureSettings()
