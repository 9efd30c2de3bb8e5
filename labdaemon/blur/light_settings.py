"""Thresholds of frames that show the phase; the sources are those of ``settings``, to which this page belongs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LightSettings:
    """Valleys of the phase, twins, and the check of the code (``phase.valleys``, ``candidates``, ``light_check``)."""

    valley_step_rad: float = 0.22
    """Distance, on either side of a minimum, from which a neighbouring one is searched: half a step of the profile."""
    min_noise_scale: float = 0.7
    """Least mean squared residual by which differences of costs are scaled: noise may be less than in the sharp frame,
    but a small one is a coincidence. Trial."""
    orbit_rivals: int = 3
    """Rivals of the best in-phase motion from which orbits are followed under coded light. Trial."""
    rival_limit: float = 30.0
    """Excess of cost up to which another motion is reported: cameras together may prefer it. Statistics: e⁻¹⁵."""
    orbit_px: float = 1.5
    """Amplitude from which a motion is fitted as an orbit also where no minor axis shows. Trial: its phase shows."""
    same_valley_rad: float = 0.4
    """Difference of phase up to which two minima are one valley, whose covariance holds both. Trial: codes of seven
    sectors make twins from 0.3 rad on, but those nearer than this are one motion for any practical purpose."""
    valley_scan_sd_rad: float = 0.015
    """Linear standard deviation of a phase from which its valley is followed on either side. Trial: narrower ones are
    parabolas."""
    valley_scan_steps: int = 6
    """Phases that are tried on either side, up to `same_valley_rad`. Trial."""
    light_parts: int = 8
    """Parts of the cycle whose brightness is checked, where the code has more sectors."""
    light_correction_sd: float = 0.05
    """Standard deviation up to which a correction of the brightness counts as seen. Trial."""
    light_mismatch_probability: float = 1e-3
    """Probability of the corrections, the code being played, below which it was not. Statistics: one capture in a
    thousand."""
    least_light_effect_sd: float = 0.3
    """Error of the motions, in their standard deviations, that counts: less is within any comparison's scatter."""
    constant_light_gain: float = 16.0
    """Squared standard deviations by which constant light must explain a frame better. Statistics: four sd."""
    outlier_share: float = 0.25
    """Largest share of targets that are left out of the check of the code because they contradict it most. Trial."""
    least_agreement: float = 0.1
    """Part of the squared standard deviations of all targets that the others must have, too. Trial."""
    unknown_noise_scale: float = 16.0
    """Squared standard deviations of residuals that count as one where noise is not known, or a patch's own. Trial."""
    agreement_probability: float = 0.05
    """Probability of the others' corrections, the code being played, below which they agree. Statistics."""
    least_eigenvalue: float = 1e-6
    """Eigenvalue of a target's information, relative to the largest, below which a correction is not seen. Numerics."""
    min_ambient_targets: int = 4
    """Other targets of a frame from which their common ambient light replaces the stated one. Trial: their scatter must
    show."""
    least_ambient_share: float = 1e-3
    """Information of an image on the ambient light, over the prior's, that counts. Numerics."""
    ambient_scatter_probability: float = 0.05
    """Probability of the targets' differences below which the ambient light differs between places. Statistics."""
    ambient_contradiction_sd: float = 4.0
    """Standard deviations by which the images must contradict the stated ambient light before it is put aside.
    Statistics: four sd."""
    max_ambient_scatter: float = 0.25
    """Scatter between places, in parts of the correction, up to which ambient light explains it. Trial."""
    ambient_explains_probability: float = 0.05
    """Probability of what is left, the code being played, from which free ambient light explains the frames: it also
    takes up a part of a wrong code. Statistics."""
    free_ambient_sd: float = 0.5
    """Standard deviation of ambient light that was stated wrongly, in parts of the lamp's full brightness. Trial."""
    arc_sd_rad: tuple[float, float] = (0.04, 0.15)
    """Least and largest standard deviation of the phase of one motion of an arc. Trial: it is straight there."""
    arc_spacing: float = 1.6
    """Distance between the motions of an arc, in standard deviations of one. Numerics: their sum is even to 1 %."""
    min_rest_targets: int = 5
    """Other settled targets of a frame from which the drift from the places of rest is known. Trial: it is a median."""
    rest_sd_px: float = 0.01
    """Least standard deviation of a place of rest. Trial: sharp frame and camera motion, from renders."""
    rest_conflict: float = 20.0
    """Excess of a place of rest from which it contradicts a motion. Statistics: 5e-5."""
    rest_conflict_ratio: float = 0.1
    """Distance from rest, in parts of the amplitude, that another phase may explain. Trial: codes shift by a third."""
    median_deviation: float = 0.6745
    """Median absolute deviation of a normal distribution, in standard deviations."""
    coded_minima: int = 6
    """Local minima of the phase profile that are refined where the phase shows. Trial."""
    hidden_minima: int = 3
    """Minima between the phases of the profile that are refined, beyond those. Speed."""
    code_axes: int = 3  # axes about which a code most resembles its mirror image, each tried as a twin; trial


LIGHT = LightSettings()
