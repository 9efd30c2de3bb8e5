"""All thresholds of blur/ on one page: name, unit, and where the value comes from.

Sources: *Statistics*, the value follows from a stated probability. *Numerics*: from the precision of the arithmetic.
*Trial*: chosen on rendered and real frames; ``labdaemon bench accuracy`` and the tests hold what it gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """Damped Gauss–Newton iterations (``solver``)."""

    undamped: float = 1e-3
    """Relative damping up to which a short step means convergence, and is not short because of the damping. Trial."""
    linear_step_px: float = 0.05
    """Step, px or px², up to which the model counts as linear: the error is a hundredth of a standard deviation."""
    last_step_sd: float = 0.1
    """Step, in standard deviations, after which the fit stops. Statistics: it changes the total error by 0.5 %."""
    reweighted_iterations: int = 2
    """Iterations in which the weights still follow the model. Later they are frozen, so that they do not bias it."""
    equal_cost: float = 1e-5
    """Relative difference up to which two costs are equal. Numerics: sums in single precision."""


@dataclass(frozen=True, slots=True)
class CacheSettings:
    """Tables and spectra that are kept between fits. Numerics, and memory: at most 80 MB."""

    max_dots: int = 192
    """Dots whose spectra at rest are kept: they stay the same for a campaign."""
    max_frequencies: int = 6000
    """Largest grid, in frequencies, whose spectra are kept: patches come in few sizes."""
    bessel_steps: int = 128
    """Table entries per unit of the argument of J0 and J1. Linear interpolation is then good to 4e-6."""
    bessel_max: float = 256.0
    """Largest argument in the table: 60 px of motion at the highest frequencies."""


@dataclass(frozen=True, slots=True)
class MeasureSettings:
    """Which fit a patch gets (``measure``)."""

    occlusion_chi2: float = 2.5
    """Mean squared residual from which an occluder is searched. Trial: harmonics of a motion make less."""
    whole_cycle_tolerance: float = 0.01
    """Cycles from a whole number below which the phase of the window does not show. Trial."""
    part_cycle_limit: float = 0.05
    """Cycles from a whole number above which the model of whole cycles is biased (flag ``part_cycles``). Contract."""
    min_contrast_ratio: float = 0.2
    """Contrast of a textured patch, over the sharp frame's, below which the patch is not in the frame. Trial."""
    mean_floor_px2: float = 1e-6
    """Variance that keeps a straight path's covariance invertible in a weighted mean. Numerics."""
    contradiction_probability: float = 1e-5
    """Probability of the χ² between a group's members below which they contradict each other. Statistics."""
    member_floor_px: float = 0.005
    """Error of each member that no sd states (interpolation, a change of scale with depth). Trial."""


@dataclass(frozen=True, slots=True)
class WholeCycleSettings:
    """The everyday fit (``fit.whole_cycles`` and ``fit.accelerated``)."""

    min_moment_px2: float = 0.05
    """Smallest a² of an initial straight path: at rest the image does not depend on a, and its gradient vanishes."""
    fixed_moment_px2: float = 1e-4
    """The same where a is not fitted at all, because the orbit's fit shows rest."""
    min_fast_amplitude_px: float = 1.2
    """Semi-amplitude from which the moments of the blurred dot are a good initial straight path. Trial."""
    last_step_px: float = 0.2
    """Step, px or px², after which a warm start ends. Trial: one Gauss–Newton step follows."""
    last_moment_step_px2: float = 1.0
    """The same for the second moment of an orbit, in which the model is nearly linear."""
    min_defocus_px2: float = -1.0
    """Smallest extra variance that a frame can have (the sharp frame was the less sharp one). Trial."""
    max_defocus_px2: float = 50.0
    """Largest one. Trial."""
    min_moment_eigenvalue_px2: float = -1.5
    """Smallest eigenvalue of aaᵀ + bbᵀ during the iterations: noise may ask for a negative one near rest. Trial."""


@dataclass(frozen=True, slots=True)
class StaticTargetSettings:
    """Targets that do not move (``fit.static_target``)."""

    defocus_sd_px2: float = 30.0
    """Prior standard deviation of the extra variance: it is what these targets measure, so the prior is wide."""
    same_shift_px: float = 0.05
    """Shift below which two initial values are one. Trial."""
    max_unshifted_px: float = 0.1
    """Shift above which a fit that began without shift is repeated: its weights are not those of its end. Trial."""
    poor_chi2: float = 2.0
    """Mean squared residual above which the fit is flagged. Trial: the interpolation of an image makes 1.5."""


@dataclass(frozen=True, slots=True)
class OcclusionSettings:
    """Targets behind an occluder (``fit.occlusion``). Trial, on rendered scenes with cables and corners."""

    trial_amplitudes: tuple[float, ...] = (0.15, 0.35, 0.8, 1.4, 2.2)
    """Semi-amplitudes that are compared with the patch, in radii of the dot; rest is one more."""
    trial_directions: int = 8
    """Directions of each, evenly over half a turn."""
    trial_step: float = 0.3
    """Distance of the positions that are compared, in radii of the dot."""
    ranking_limit: float = 25.0
    """Residual, in standard deviations, at which a pixel's cost is capped while trial motions are ranked."""
    biweight_limits: tuple[float, ...] = (25.0, 12.0, 6.0)
    """Residuals at which the biweight becomes zero, in the successive fits of a motion."""
    fitted_motions: int = 6
    """Best-ranked motions that are fitted."""
    first_iterations: int = 8
    """Most iterations of these first fits, which are then compared."""
    hopeless_chi2: float = 25.0
    """Mean squared residual of all first fits above which no target is in view. Trial: 1 to 14 behind cables and
    corners, 31 to 45 on a card with spots."""
    refined_motions: int = 2
    """Distinct results of these that are fitted further."""
    same_motion_px: float = 0.3
    """Difference of place and amplitude from which two results are distinct."""
    outlier_limit: float = 4.0
    """Smoothed residual, in standard deviations, from which a pixel is an outlier."""
    margins_px: tuple[int, int] = (2, 4)
    """Two widths by which the outliers are dilated, for the occluder's soft edge; the results must agree."""
    min_visible_fraction: float = 0.03
    """Part of the blurred dot's darkness that must stay in view."""
    missing_fraction: float = 0.08
    """Part of the target's darkness that no motion of the target removes or adds."""
    outline_fraction: float = 0.3
    """Part of the motion by which the outline of another motion may differ."""
    absent_fraction: float = 0.85
    """Missing part from which no target is in the patch."""
    max_contrast_change: float = 0.12
    """Largest relative change of the ink's contrast against the sharp frame: an occluder has another contrast."""
    max_sd_px: float = 0.3
    """Standard deviation of the amplitude from which nothing is reported; twice this at rest."""
    max_sd_fraction: float = 0.05
    """The same as a part of the amplitude; the larger of the two counts."""


@dataclass(frozen=True, slots=True)
class RefitSettings:
    """The fit without the largest region of outliers (``fit.refit``). Trial."""

    outlier_limit: float = 4.0
    """Smoothed residual, in standard deviations, from which a pixel is an outlier."""
    max_hidden_fraction: float = 0.45
    """Part of the patch that may be masked; the fit of less than the rest is not believed."""


@dataclass(frozen=True, slots=True)
class GlsSettings:
    """Generalised least squares with the paper texture as correlated noise (``smear.gls``)."""

    curvature_sd: float = 0.02
    """Prior standard deviation of the relative curvature of the illumination over a patch. Trial: lamps, flare."""
    moving_prior: tuple[float, float] = (1.0, 0.5)
    """Amplitude of the mapped texture that moves with the target, and its prior standard deviation: labels move."""
    static_prior: tuple[float, float] = (0.0, 0.5)
    """Amplitude of the mapped texture that stays behind (a wall, the sensor's pattern), and its prior sd."""
    max_texture_amplitude: float = 1.5
    """Largest amplitude that counts in the weights of what is not mapped. Trial."""
    max_chi2: float = 4.0
    """Mean squared residual above which better weights do not help: the residuals are not noise. Trial."""
    frame_steps: int = 4
    """Most steps for frames through known windows, which are nearly linear but for the phase. Numerics."""
    max_step_sd: float = 30.0  # distance from the unrefined solution beyond which that is kept; trial
    margin_px: int = 8
    """Zeros around the filtered images, against wrap-around. Numerics."""


@dataclass(frozen=True, slots=True)
class UncertaintySettings:
    """Covariance and flags (``smear.uncertainty``)."""

    rest_sds: float = 3.0
    """A squared amplitude below so many of its standard deviations is rest. Statistics: 0.13 % one-sided."""
    poor_chi2: float = 1.35
    """Mean squared residual above which a fit is flagged ``poor_fit``. Trial."""
    white_chi2: float = 1.1
    """Mean squared residual below which the residuals are the noise model's. Trial: some 500 pixels scatter by 6 %."""
    bands: int = 8
    """Bands of spatial frequency in which the power of the residuals is averaged. Trial."""
    saturated_fraction: float = 0.2
    """Part of a patch at white level from which saturation is considered. Trial."""
    undetermined_sd_px: float = 0.1
    """Standard deviation of the amplitude above which such a patch is flagged ``saturated``. Trial."""
    undetermined_sd_fraction: float = 0.02
    """The same as a part of the amplitude; the larger of the two counts."""


@dataclass(frozen=True, slots=True)
class PhaseSettings:
    """Motion through known windows (``phase``)."""

    linear_phase_sd_rad: float = 0.12
    """Standard deviation of the phase up to which the linear covariance holds. Trial: the chord error is then 0.4 %."""
    arc_sds: float = 4.0
    """Standard deviations of a phase over which its arc is followed. Statistics."""
    phase_count: int = 256
    """Phases over which the posterior is summed. Numerics."""
    rival_cost: float = 9.0
    """Difference of costs below which another solution may be the true one. Statistics: three standard deviations."""
    barrier_cost: float = 16.0
    """Cost between two minima from which they are two. Statistics: four standard deviations."""
    same_middle_rad: float = 0.05
    """Difference of mid-exposure phases, modulo half a cycle, from which each gives a time-reversed solution. Trial."""
    same_motion_fraction: float = 0.02
    """Part of the motion's size by which a distinct solution differs. Trial."""
    single_frame_phases: int = 9
    """Phases that are tried over half a circle for a single frame; the other half is time-reversed. Trial."""
    group_phases: int = 16
    """Phases that are tried over the whole circle for several frames. Trial."""
    min_window_variance: float = 0.02
    """Smallest variance of the motion over a window that is divided by, in an initial guess. Numerics."""
    min_moment_px2: float = 0.05
    """Smallest second moment of an initial in-phase motion. Numerics: its gradient vanishes at rest."""
    min_orbit_moment_px2: float = 0.02
    """Smallest eigenvalue of the second moment of an initial orbit. Numerics."""
    followed_minima: int = 2
    """Local minima of a single frame's phase profile that are refined. Trial."""
    min_along_px: float = 0.02
    """Least component of v on its own side, while its phase is held. Numerics."""
    max_extra_cost: float = 60.0
    """Cost above the best from which a minimum is not refined. Statistics: its odds are e⁻³⁰."""
    followed_starts: int = 4
    """Initial orbits that are iterated to convergence. Trial."""
    distinct_distance2: float = 16.0
    """Squared Mahalanobis distance from which two solutions are distinct. Statistics: four standard deviations."""
    equal_cost: float = 2.0
    """Difference of costs up to which a time-reversed solution is as good, whatever the uncertainty. Akaike."""
    max_phase_sd_rad: float = 0.1
    """Standard deviation of an orbit's phase from which all phases are tried. Trial."""
    min_probability: float = 0.01
    """Probability of the other direction of rotation below which the linear covariance holds. Statistics."""


@dataclass(frozen=True, slots=True)
class SignSettings:
    """Relative signs of the targets of a frame (``phase.signs``)."""

    phase_spreads_deg: tuple[float, ...] = (1.0, 2.0, 4.0)
    """Standard deviations of the targets' phases about the common one, degrees; the data weigh them. Trial."""
    outlier_share: float = 0.1
    """Prior share of targets at any other phase. Trial."""
    common_phase_share: float = 0.75
    """Share of the targets whose own phase shows that must be at the common phase. Trial."""
    log_odds_limit: float = float(2 * np.log(100.0))
    """Twice the logarithm of the odds from which a sign is stated. Statistics: one in a hundred is wrong at most."""


@dataclass(frozen=True, slots=True)
class SharpFitSettings:
    """The target at rest (``sharp.fit_sharp``)."""

    blurred_px2: float = 1.0
    """Blur in one direction, as a², from which a sharp frame counts as blurred. Trial."""
    blurred_cost_fraction: float = 0.35
    """Part of the residuals that this blur must explain. Trial."""
    margin_px: int = 16
    """Pixels between a patch and its periodic images. Numerics."""
    blur_test_chi2: float = 1.5
    """Mean squared residual from which a sharp frame is tested for blur. Trial."""
    min_noise_fraction: float = 0.75
    """Smallest noise, over the noise between neighbouring pixels, that the texture's share may leave. Trial."""
    max_noise_chi2: float = 4.0
    """Mean squared residual, against the noise between neighbours, above which residuals are not noise. Trial."""


@dataclass(frozen=True, slots=True)
class TemplateResidualSettings:
    """What a sharp image shows beyond an ideal dot (``sharp.template_residual``). Trial."""

    outline_band_px: float = 3.0
    """Half width of the band about the dot's outline, where its lens blur reaches."""
    smear_margin_px: float = 2.5
    """Paper beyond the blurred dot that is used around a dot with a strong residual."""
    min_rms: float = 0.012
    """RMS residual over the dot's contrast, below which it counts as paper texture, that is noise."""
    strong_rms: float = 0.02
    """RMS residual over the dot's contrast, above which pixels without a measured residual are masked."""


@dataclass(frozen=True, slots=True)
class TargetShapeSettings:
    """How far a target's shape may differ between the sharp and the blurred frame (``sharp.target``)."""

    min_focal_px: float = 3000.0
    """Shortest focal length, px: it bounds the change of scale with a change of depth. Common lenses and sensors."""
    distortion_sd: float = 0.02
    """Standard deviation of a label's rotation and stretch between the frames, rad. Trial: loose paper labels."""


@dataclass(frozen=True, slots=True)
class TextureMapSettings:
    """Map of the paper texture around a dot (``sharp.texture_map``). Trial."""

    dot_margin_px: float = 4.0
    """Ring around the dot in which the dot's own fit knows the illumination best."""
    edge_margin_px: float = 4.5
    """Distance that is kept from the paper's edge, whose blur darkens what lies before it."""
    max_radius_px: float = 130.0
    """Paper that is mapped beyond the dot: twice the longest paths."""
    skirt_px: float = 45.0
    """Paper around the dot from which its diffracted skirts are taken off; beyond, they are below 0.05 %."""
    max_skirt: float = 0.5
    """Largest part of the light that is divided out: darker pixels are the dot itself. Numerics."""
    min_pixels: int = 400
    """Pixels of paper that each colour must have."""
    background_size_px: int = 41
    """Square over which the paper's brightness is averaged: what is longer is illumination, not texture."""
    max_variance_ratio: float = 1.5
    """Variance, over noise and texture near the dot, from which the surface is not plain paper."""


@dataclass(frozen=True, slots=True)
class LocateSettings:
    """The rough position of a blurred dot (``patch.locate``). Trial: speed."""

    coarse_plane_pixels: int = 1500
    """Pixels from which a quarter of them finds the plane of illumination."""
    coarse_search_area_px2: float = 200.0
    """Area of dots that are found at half the resolution."""


@dataclass(frozen=True, slots=True)
class ProfileSettings:
    """The published method (``mccarthy2016``); the first two values are the paper's."""

    profiles: int = 20
    """Number of intensity profiles."""
    threshold_px: float = 0.01
    """Discrepancy at which the refinement ends."""
    max_iterations: int = 40
    """Iterations of the refinement. Trial."""
    step_px: float = 0.25
    """Distance of the samples along a profile. Trial."""
    smoothing_px: float = 0.8
    """Standard deviation of the smoothing before differentiation: photon noise has features everywhere. Trial."""
    core_darkness: float = 0.9
    """A core this dark was covered all the time: the path is shorter than the dot. Trial."""
    thresholds: tuple[float, ...] = (0.15, 0.2, 0.27, 0.36, 0.48)
    """Thresholds of the rapid estimate, in parts of the largest darkness, from white towards ink. Trial."""
    outline_scatter: float = 0.05
    """Scatter of an outline about its ellipse, relative, below which a higher threshold is not tried. Trial."""
    round_ratio: float = 0.88
    """Ratio of the axes from which an outline says nothing of the direction. Trial."""
    directions: int = 4
    """Directions that are then tried, evenly over half a turn from that of the second moments. Trial."""
    realign_rad: float = 0.09
    """Turn of the path against the profiles from which they are laid again. Trial."""
    max_realign_rad: float = 0.52
    """Turn beyond which the path is not believed. Trial."""
    rest_sigmas: float = 4.0
    """Excess over the sharp dot's own reading, in its sd, below which a target is at rest. Real frames."""
    max_still_ratio: float = 0.3
    """Reading of the sharp dot in parts of its radius from which features are mistaken. Real frames."""


@dataclass(frozen=True, slots=True)
class LabelSettings:
    """Where the label of a dot ends (``mccarthy2016.label``). All by trial on real frames."""

    rays: int = 96
    """Directions in which the edge is looked for."""
    step_px: float = 0.5
    """Distance of the samples along a ray."""
    smoothing_px: float = 0.7
    """Standard deviation of the smoothing before that."""
    rise: float = 0.06
    """Darkness above the lightest place of a ray at which background begins."""
    neighbours: int = 5
    """Rays of which the nearest edge counts."""
    fill_smoothing_px: float = 1.5
    """Standard deviation of the smoothing of what is filled in."""


SOLVER = SolverSettings()
CACHE = CacheSettings()
MEASURE = MeasureSettings()
WHOLE_CYCLES = WholeCycleSettings()
STATIC_TARGET = StaticTargetSettings()
OCCLUSION = OcclusionSettings()
REFIT = RefitSettings()
GLS = GlsSettings()
UNCERTAINTY = UncertaintySettings()
PHASE = PhaseSettings()
SIGNS = SignSettings()
SHARP_FIT = SharpFitSettings()
TEMPLATE_RESIDUAL = TemplateResidualSettings()
TARGET_SHAPE = TargetShapeSettings()
TEXTURE_MAP = TextureMapSettings()
LOCATE = LocateSettings()
PROFILE = ProfileSettings()
LABEL = LabelSettings()
