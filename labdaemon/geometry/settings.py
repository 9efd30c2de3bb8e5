"""All thresholds of geometry/ on one page: name, unit, and where the value comes from.

*Statistics*: the value follows from a stated probability. *Numerics*: from the precision of the arithmetic. *Trial*: no
theory gives the value; it was chosen on rendered and on real networks, and the tests hold what it gives.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SnoopingSettings:
    """Robust adjustment and data snooping (``data_snooping``, ``reliability``)."""

    significance: float = 0.001
    """Probability that data without gross errors lose an observation, shared between all of them. Baarda (1968)."""
    noncentrality: float = 4.13
    """Standard deviations of an error that a test of 0.1 % finds with 80 % probability: 3.29 + 0.84. Baarda (1968)."""
    cauchy_scale2: float = 6.0
    """Squared normalised residual of a point (two coordinates) from which its influence falls. Statistics: 5 %."""
    max_scale: float = 25.0
    """Largest factor by which residuals larger than stated raise the limit. Trial."""
    min_redundancy: float = 1e-6
    """Redundancy below which an observation cannot be tested. Numerics."""
    min_redundancy_for_size: float = 1e-3
    """Smallest redundancy that the size of an error is divided by. Numerics."""
    inflation_probability: float = 0.01
    """Probability of the residuals below which the covariance is scaled by sigma0². Statistics."""


@dataclass(frozen=True, slots=True)
class OrientationSettings:
    """Exterior orientation and the plane of one camera (``orient``, ``plane``, ``camera_motion``, ``control``)."""

    max_sigma0: float = 10.0
    """Residuals over their standard deviation from which frame, lens and survey do not belong together. Trial."""
    max_triples: int = 120
    """Triples of points from which initial camera poses are computed. Trial: speed."""
    max_initial_cameras: int = 6
    """Initial poses that are adjusted. Trial: speed."""
    initial_slope_error: float = 0.002
    """Error of a ray's slope that an initial pose may have. Trial."""
    min_extent_mm: float = 20.0
    """Smallest extent of control in millimetres: the targets alone are that large. It uncovers a survey in metres."""
    min_survey_sd_mm: float = 0.05
    """Standard deviation that a survey hardly beats; it judges coplanarity where a smaller one is claimed. Trial."""
    coplanar_significance: float = 0.001
    """Probability that coplanar control is refused. Statistics."""
    position_prior_mm: float = 1.0
    """Prior standard deviation of the position of a camera on a tripod between two frames: few control targets do not
    separate a small shift from a small rotation. Trial."""
    min_shift_px: float = 1.0
    """RMS shift of the control targets from which a frame is flagged ``camera_moved``. Less is corrected."""
    max_residual_px: float = 5.0
    """Residual that goes with `max_sigma0`: smaller ones do not come from another camera's frame. Trial."""


@dataclass(frozen=True, slots=True)
class IntersectionSettings:
    """Intersection of a target's motion (``space_intersection``, ``motion_candidates``, ``motion_adjustment``)."""

    match_cost_gap: float = 14.0
    """Difference of costs that resolves a match. Statistics: the runner-up is a thousand times less likely."""
    distinct_probability: float = 0.01
    """Probability below which two candidates are distinct. Statistics."""
    straight_ratio2: float = 12.0
    """Squared ratio of a minor axis to its standard deviation below which a path is straight. Statistics: 0.05 %."""
    orbit_trial_probability: float = 1e-3
    """Probability of a straight path's residuals in two cameras below which an orbit is tried. Statistics."""
    orbit_cost_gain: float = 4.0
    """Cost that the two further parameters of an orbit must remove with three cameras. Akaike's criterion."""
    same_root_mm: float = 0.02
    """Distance below which the two roots of an orbit are one, for any practical purpose. Trial."""
    sign_conflict_probability: float = 1e-3
    """Probability of signed residuals below which one camera has the wrong one of two orbits. Statistics."""
    poor_fit_probability: float = 1e-6
    """Probability of the residuals below which the cameras do not see the same point. Statistics."""
    poor_fit_px: float = 0.2
    """Residual below which nothing is flagged, however small the stated uncertainty. Trial."""
    max_alternatives: int = 4
    """Motions of each image that are combined with those of the other cameras. Speed."""
    max_combinations: int = 32
    """Combinations that are intersected. Speed."""
    twin_cost_gap: float = 9.0
    """Difference of costs that excludes a twin. Statistics: the wrong one is taken with 0.13 % at most, which is where
    the two are three standard deviations apart."""
    motions_apart: float = 0.35
    """Distance between two signed motions, in parts of the larger, from which they are two. Trial: nearer ones are
    reported by their mean, their spread in its covariance."""
    max_arc_motions: int = 32
    """Motions along an arc of phases that are intersected with those of the other cameras. Speed."""
    negligible_cost: float = 18.0
    """Difference of costs from which a motion has no part in a mixture. Statistics: 1e-4."""
    in_phase_ratio: float = 0.02
    """Ratio of the axes up to which a structure's motion counts as in phase, before its capture is known. Trial:
    damping of a few per cent."""
    in_phase_factors: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    """Factors of that ratio of which a capture's own targets choose one. Numerics."""
    in_phase_log_cost: float = 1.0
    """Power of the factor by which a larger ratio is less probable beforehand. Trial."""
    in_phase_steps: int = 8
    """Most steps to a motion in phase. Numerics: three do where the cameras know the phase."""
    in_phase_step_mm: float = 1e-5
    """Step that is the last one. Numerics."""
    orbit_share: float = 0.2
    """Prior share of motions that are orbits of any ratio. Trial."""
    orbit_share_targets: float = 4.0
    """Targets as which that prior counts against those of the capture. Trial."""
    orbit_share_steps: int = 20
    """Steps to the capture's own share of orbits. Numerics."""
    phase_spread_rad: float = 0.05
    """Spread of phases about the one that targets of one mode share. Trial: complex modes of damped structures."""
    other_phase_share: float = 0.2
    """Prior share of targets that do not move at a phase where others do. Trial."""
    common_phase_share: float = 0.6
    """Share of the settled targets that must be at one phase for it to count. Trial."""
    min_phase_neighbours: int = 5
    """Settled targets whose phases describe the others'. Trial."""
    max_evidence: float = 40.0
    """Largest evidence of one camera for a sign, twice the log odds: rays that miss each other count for more."""
    min_axis_sd_px: float = 0.01
    """Standard deviation below which no blur measures a minor axis. Trial."""
    min_ray_angle_rad: float = 0.02
    """Angle between rays below which they give no depth. Trial."""
    floor_px2: float = 1e-8
    """Variance that keeps a covariance of zero invertible. Numerics."""
    max_concentration: float = 1e6
    """Concentration of a von Mises distribution from which its phase is known. Numerics."""


@dataclass(frozen=True, slots=True)
class NeighbourSettings:
    """Resolution of an ambiguous match by the target's neighbours (``continuity``)."""

    min_odds: float = 100.0
    """Odds for the chosen solution. Statistics."""
    min_neighbours: int = 5
    """Resolved targets that describe a population of motions. Trial."""
    continuity_ratio: float = 3.0
    """Distance of the other solution from the neighbours' vector, over the chosen one's. Trial."""
    min_spread: float = 0.1
    """Smallest spread of a population, in parts of its rms vector. Trial."""
    max_distance2: float = 9.0
    """Squared Mahalanobis distance above which no solution belongs to the population. Statistics: three sd."""


SNOOPING = SnoopingSettings()
ORIENTATION = OrientationSettings()
INTERSECTION = IntersectionSettings()
NEIGHBOURS = NeighbourSettings()
