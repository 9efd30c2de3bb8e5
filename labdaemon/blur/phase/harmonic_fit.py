"""A periodic motion through known windows, one frame or several: in phase where that explains it, else an orbit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from labdaemon.blur.light_settings import LIGHT
from labdaemon.blur.motion import AlternativeMotion, AmbientEstimate, LightScore
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.phase.candidates import ambient_estimate, weigh_candidates
from labdaemon.blur.phase.in_phase import PhaseProfile, mean_waveform, profile_phase
from labdaemon.blur.phase.light_check import score_light
from labdaemon.blur.phase.orbit_phase import marginalise_orbit_phase
from labdaemon.blur.phase.orbits import MinorAxis, estimate_minor_axis, solve_orbit
from labdaemon.blur.phase.phase_arc import PhaseTable, across_path, condition_on_phase, phase_arc
from labdaemon.blur.phase.posterior import (
    InPhaseMotion,
    in_phase_jacobian,
    in_phase_vectors,
    is_bimodal,
    marginalise_phase,
)
from labdaemon.blur.settings import PHASE, UNCERTAINTY
from labdaemon.blur.smear.frame_set import (
    FRAME_PARAMETERS,
    FrameSet,
    window_in_phase_transfer,
    window_orbit_transfer,
)
from labdaemon.blur.smear.uncertainty import windowed_covariance
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.half_turn import major_phase_rad


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicFit:
    """What was found.

    Attributes
    ----------
    value, covariance
        (6,) x, y, ax, ay, bx, by in terms of the excitation's phase (of the first opening, where that is unknown);
        (6, 6). Of a single frame a and b are one of two mirror images in time.
    size_px, sd_size_px
        sqrt(|a|² + |b|²), which shows whether or not the phase does.
    solution
        The fit behind it.
    profile
        The in-phase motion that fits best.
    in_phase
        The in-phase motion that a and b are; None where they are an orbit's.
    fixed_phase_covariance
        (6, 6) of an orbit's value with its phase held.
    minor_axis_variance_px2
        Mean square of a minor axis that an in-phase motion may have.
    tables
        The motions at all phases, where the phase hardly shows; else nothing.
    ambiguous
        Whether another solution, clearly apart, fits as well.
    anisotropy_px2
        How far the extra blur may be from the same in all directions.
    alternatives
        Other motions under coded light that the frames do not exclude.
    light_scores
        Of each frame under coded light, what it says of the code.
    ambient
        What it says of the ambient light under coded light, where that is a parameter and the phase shows.
    """

    value: FloatArray
    covariance: FloatArray
    size_px: float
    sd_size_px: float
    solution: Solution
    profile: PhaseProfile
    in_phase: InPhaseMotion | None
    fixed_phase_covariance: FloatArray
    minor_axis_variance_px2: float
    tables: tuple[PhaseTable, ...]
    ambiguous: bool
    anisotropy_px2: float = 0.0
    alternatives: tuple[AlternativeMotion, ...] = ()
    light_scores: tuple[LightScore, ...] = ()
    ambient: AmbientEstimate | None = None

    @property
    def arc(self) -> tuple[AlternativeMotion, ...]:
        """The motions that the image may show, where the phase hardly shows; else nothing."""
        return phase_arc(self.tables) if self.tables else ()

    @property
    def at_rest(self) -> bool:
        """Whether the motion is within the detection limit: an amplitude shows by its square."""
        limit = float(np.hypot(2 * self.size_px * self.sd_size_px, self.anisotropy_px2))
        return self.size_px**2 < UNCERTAINTY.rest_sds * limit


def fit_harmonic(frame_set: FrameSet, *, orbit: bool = True) -> HarmonicFit:
    """Fit an in-phase motion, and an orbit where its minor axis shows; under coded light wherever the phase shows.

    Parameters
    ----------
    frame_set
        The target in its frames.
    orbit
        False forces straight motion.
    """
    moment_px2 = smear_moment(frame_set)
    profile = profile_phase(frame_set, moment_px2)
    minor = estimate_minor_axis(frame_set, profile)
    one_sided = max(blur.anisotropy_px2 for blur in frame_set.blurs)
    unsure = float(np.hypot(minor.sd_square_px2, one_sided))
    # A damped structure moves on thin orbits. Under a code a straight fit turns towards a minor axis of which it knows
    # nothing: the code weighs sine and cosine differently in each part of the cycle.
    is_coded_motion = profile.coded and float(np.hypot(*profile.vector)) > LIGHT.orbit_px
    if orbit and (is_coded_motion or minor.square_px2 > UNCERTAINTY.rest_sds * unsure):
        found = _fit_orbit(frame_set, profile, moment_px2, minor)
    else:
        found = _fit_in_phase(frame_set, profile, moment_px2, minor)
    return replace(found, anisotropy_px2=one_sided)


def _fit_orbit(frame_set: FrameSet, profile: PhaseProfile, moment_px2: FloatArray, minor: MinorAxis) -> HarmonicFit:
    """The orbit whose minor axis shows, and whether its time-reversed solution fits as well."""
    best, others, time_reversed = solve_orbit(
        frame_set, moment_px2, profile, float(np.sqrt(max(minor.square_px2, minor.size_px**2)))
    )
    # Constant light has the time-reversed solution as its only twin; the covariance holds the other rotation.
    rivals = others if profile.coded else [] if time_reversed is None else [time_reversed]
    weighed = weigh_candidates(frame_set, [best, *rivals] if frame_set.shows_phase else [best], window_orbit_transfer)
    if weighed.best is time_reversed:
        time_reversed = best
    best, refined = weighed.best, weighed.refined
    full = windowed_covariance(refined, frame_set, window_orbit_transfer)
    selector = _motion_selector(frame_set, len(best.p), 4)
    value, covariance = selector @ refined.p, selector @ full @ selector.T
    held = condition_on_phase(value, covariance)
    size, sd = _vector_length(value[2:], held[2:, 2:])
    tables, alone = tuple[PhaseTable, ...](), not frame_set.shows_phase
    # A single frame under constant light always has its time-reversed solution.
    linear, alternatives = covariance, tuple[AlternativeMotion, ...]()

    def signed(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        return selector @ p, selector

    near = bool(others) and _cost_excess(best, others[0]) < PHASE.rival_cost and not profile.coded
    if not alone and (near or _sd_phase(value, covariance) > PHASE.max_phase_sd_rad):
        covariance, tables = marginalise_orbit_phase(frame_set, profile, best, value, covariance)
    ambiguous = alone
    if profile.coded:
        said = weighed.report(frame_set, value, covariance, _nothing_unmodelled, signed)
        covariance, alternatives, scatter_px2 = said.covariance, said.alternatives, said.axis_scatter_px2
        phase = major_phase_rad(value[2:4], value[4:])
        unit = np.array([np.cos(phase), np.sin(phase)])
        held[2:, 2:] += np.kron(np.outer(unit, unit), scatter_px2)
        if not tables and said.table is not None and _is_arc(scatter_px2, value, covariance):
            tables = (said.table,)
        ambiguous = any(one.excess < PHASE.rival_cost for one in alternatives)
    elif time_reversed is not None:
        away = selector @ (time_reversed.p - best.p)
        ambiguous = ambiguous or _is_ambiguous(_cost_excess(best, time_reversed), away, linear, away, covariance)
        if not alone and not tables:
            alternatives = weighed.report(frame_set, value, covariance, _nothing_unmodelled, signed).alternatives
    mean = mean_waveform(frame_set)
    tables = tuple(replace(table, waveform_mean=mean) for table in tables)
    found = HarmonicFit(value, covariance, size, sd, refined, profile, None, held, 0.0, tables, ambiguous)
    if not profile.coded:
        return replace(found, alternatives=alternatives)
    return replace(
        found,
        alternatives=alternatives,
        light_scores=score_light(frame_set, best, window_orbit_transfer, moment_px2, selector, covariance),
        ambient=None if tables else ambient_estimate(frame_set, refined, full, selector),
    )


def _fit_in_phase(frame_set: FrameSet, profile: PhaseProfile, moment_px2: FloatArray, minor: MinorAxis) -> HarmonicFit:
    """The in-phase motion by all its phases, with the minor axis that it may have in the covariance."""
    candidates = [profile.best, *profile.rivals] if frame_set.shows_phase else [profile.best]
    weighed = weigh_candidates(frame_set, candidates, window_in_phase_transfer)
    best, refined = weighed.best, weighed.refined
    profile = replace(profile, best=refined if frame_set.shows_phase else best)
    full = windowed_covariance(refined, frame_set, window_in_phase_transfer)
    selector = _motion_selector(frame_set, len(best.p), 3)
    linear = selector @ full @ selector.T
    inflation = _variance_inflation(best, refined, profile.vector)
    in_phase = marginalise_phase(profile, selector @ refined.p, linear, selector @ best.p, inflation)
    size, sd = _vector_length(in_phase.axis[2:], in_phase.axis_covariance[2:, 2:])
    minor_axis_variance_px2 = minor.mean_square(size)
    mean = mean_waveform(frame_set)

    def unmodelled(motion: FloatArray) -> FloatArray:
        phase = major_phase_rad(motion[2:4], motion[4:])
        across = across_path(np.cos(phase) * motion[2:4] + np.sin(phase) * motion[4:], phase, mean)
        return minor_axis_variance_px2 * np.outer(across, across)

    covariance = in_phase.covariance + unmodelled(in_phase.value)
    ambiguous, alternatives = is_bimodal(profile), tuple[AlternativeMotion, ...]()
    ambient: AmbientEstimate | None = None
    table = in_phase.table
    if table is not None:
        table = replace(table, minor_px2=minor.orbit_mean_square(size), waveform_mean=mean)
    if frame_set.shows_phase and table is None:

        def signed(p: FloatArray) -> tuple[FloatArray, FloatArray]:
            return in_phase_vectors((selector @ p)[None])[0], in_phase_jacobian(selector @ p) @ selector

        said = weighed.report(frame_set, in_phase.value, covariance, unmodelled, signed)
        covariance, alternatives, scatter_px2 = said.covariance, said.alternatives, said.axis_scatter_px2
        if _is_arc(scatter_px2, in_phase.value, covariance):
            axis_covariance = in_phase.axis_covariance.copy()
            axis_covariance[2:, 2:] += scatter_px2
            in_phase = replace(in_phase, axis_covariance=axis_covariance)
            table = None if said.table is None else replace(said.table, waveform_mean=mean)
        ambient = ambient_estimate(frame_set, refined, full, signed(refined.p)[1])
        ambiguous = any(one.excess < PHASE.rival_cost for one in alternatives)
    elif profile.rivals:
        rival = profile.rivals[0]
        vectors = in_phase_vectors((selector @ rival.p)[None])[0] - in_phase.value
        ambiguous = ambiguous or _is_ambiguous(
            _cost_excess(best, rival), selector @ (rival.p - best.p), linear, vectors, covariance
        )
    held = np.zeros((6, 6))
    scores = tuple[LightScore, ...]()
    if profile.coded:
        by_parameters = in_phase_jacobian(selector @ best.p) @ selector
        scores = score_light(frame_set, best, window_in_phase_transfer, moment_px2, by_parameters, covariance)
    return HarmonicFit(
        in_phase.value,
        covariance,
        size,
        sd,
        refined,
        profile,
        in_phase,
        held,
        minor_axis_variance_px2,
        () if table is None else (table,),
        ambiguous,
        alternatives=alternatives,
        light_scores=scores,
        ambient=ambient,
    )


def _nothing_unmodelled(motion: FloatArray) -> FloatArray:
    return np.zeros((len(motion), len(motion)))


def _variance_inflation(best: Solution, refined: Solution, vector: FloatArray) -> float:
    """Variance of an in-phase motion's amplitude at its phase with the paper texture in the weights, over without."""
    along = np.concatenate((vector / max(float(np.hypot(*vector)), 1e-12), [0.0]))
    held = np.array([0.0, 0.0, 1.0])

    def variance(covariance: FloatArray) -> float:
        part = covariance[-3:, -3:]
        by_phase = float(along @ part @ held) ** 2 / max(float(held @ part @ held), 1e-12)
        return max(float(along @ part @ along) - by_phase, 1e-12)

    return max(variance(refined.covariance) / variance(best.covariance), 1.0)


def _cost_excess(best: Solution, other: Solution) -> float:
    """By how many squared standard deviations another solution fits less well."""
    return (other.cost - best.cost) / max(best.chi2, 1.0)


def _is_ambiguous(
    worse: float, away: FloatArray, linear: FloatArray, vectors: FloatArray, covariance: FloatArray
) -> bool:
    """Whether an image in time fits as well, from a valley of its own, and the standard deviations do not say so.

    Parameters
    ----------
    worse
        Its squared residuals beyond the best solution's.
    away, linear
        From one to the other in the fit's own terms, place first, and their linear covariance there: half-way it must
        cost more than APART.
    vectors, covariance
        From one to the other as x, y, a, b, and the covariance that is reported.
    """
    if worse > PHASE.rival_cost or _mahalanobis2(away, linear) < 4 * PHASE.barrier_cost:
        return False
    return worse < PHASE.equal_cost or _mahalanobis2(vectors, covariance) > PHASE.distinct_distance2


def _mahalanobis2(away: FloatArray, covariance: FloatArray) -> float:
    motion = away[2:]
    return float(motion @ np.linalg.pinv(covariance[2:, 2:], hermitian=True) @ motion)


def _sd_phase(value: FloatArray, covariance: FloatArray) -> float:
    """Linear standard deviation of the common phase of a and b."""
    by_phase = np.concatenate((-value[4:], value[2:4]))
    return float(
        np.sqrt(max(float(by_phase @ covariance[2:, 2:] @ by_phase), 0.0)) / max(float(by_phase @ by_phase), 1e-12)
    )


def _is_arc(scatter_px2: FloatArray, value: FloatArray, covariance: FloatArray) -> bool:
    """Whether a valley of the phase was widened to an arc, which no covariance describes."""
    return bool(scatter_px2.any()) and _sd_phase(value, covariance) > PHASE.linear_phase_sd_rad


def _vector_length(vector: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Length of a vector and its standard deviation."""
    size = float(np.linalg.norm(vector))
    along = vector / max(size, 1e-12)
    return size, float(np.sqrt(max(float(along @ covariance @ along), 0.0)))


def smear_moment(frame_set: FrameSet) -> FloatArray:
    """(2, 2) aaᵀ + bbᵀ as the smears' moments have it."""
    if frame_set.moment_px2 is not None:
        return frame_set.moment_px2
    moments = [s.blob.moment_px2 for s in frame_set.problems if s.blob is not None]
    if not moments:
        return 4.0 * np.eye(2)
    defocus = float(np.mean([blur.mean_px2 for blur in frame_set.blurs]))
    moment_px2: FloatArray = 2 * (np.mean(moments, axis=0) - frame_set.sharp.form.moment_px2 - defocus * np.eye(2))
    return moment_px2


def _motion_selector(frame_set: FrameSet, size: int, motion: int) -> FloatArray:
    """(2 + motion, size) that takes the mean place and the motion from all parameters."""
    count = len(frame_set.problems)
    selector = np.zeros((2 + motion, size))
    for index in range(count):
        selector[0, FRAME_PARAMETERS * index] = selector[1, FRAME_PARAMETERS * index + 1] = 1 / count
    selector[2:, size - motion :] = np.eye(motion)
    return selector
