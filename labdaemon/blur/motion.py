"""What is known of an exposure, and what a fit says of a target's motion in it.

A point moves as ``d(t) = a sin(ωt) + b cos(ωt)`` about its mean, ωt measured from the excitation's own phase
reference. Without phase, a is the orbit's major semi-axis (sign chosen so that its largest component is positive)
and b the minor one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from labdaemon.blur.harmonics import MotionHarmonics
from labdaemon.blur.light_code import LightCode
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.errors import UsageError
from labdaemon.flags import Flag
from labdaemon.rest_place import RestPlace


@dataclass(frozen=True, slots=True)
class ExposureWindow:
    """When the shutter was open, in terms of the excitation.

    Attributes
    ----------
    frequency_hz, exposure_s
        Excitation and true length of the exposure.
    phase_rad
        Excitation phase ωt at the opening; None if it was not recorded.
    sd_phase_rad, sd_exposure_s
        Their standard deviations (timing jitter; shutter calibration).
    light
        Code of the lamp; None for constant light.
    harmonics
        Of the motion, where a gauge shows them; None for a sinusoid.
    """

    frequency_hz: float
    exposure_s: float
    phase_rad: float | None = None
    sd_phase_rad: float = 0.0
    sd_exposure_s: float = 0.0
    light: LightCode | None = None
    harmonics: MotionHarmonics | None = None

    @property
    def cycles(self) -> float:
        """Excitation cycles in the exposure."""
        return self.frequency_hz * self.exposure_s

    @property
    def fraction(self) -> float:
        """Distance of the exposure from whole cycles, cycles."""
        return abs(self.cycles - round(self.cycles))

    @property
    def is_coded(self) -> bool:
        """Whether the light follows the excitation, so that this one exposure shows the phase."""
        return self.light is not None and self.light.shows_phase


@dataclass(frozen=True, slots=True, eq=False)
class AmbientEstimate:
    """What a fit under coded light says of the ambient light (`labdaemon.blur.shared_ambient`).

    Attributes
    ----------
    correction, variance
        Of the stated ambient light, in parts of the lamp's full brightness; the prior is in both.
    cross_px
        (6,) its covariance with x, y, ax, ay, bx, by.
    prior_variance
        Of the prior, whose mean is 0.
    """

    correction: float
    variance: float
    cross_px: FloatArray
    prior_variance: float


@dataclass(frozen=True, slots=True, eq=False)
class AlternativeMotion:
    """Another motion that the same image may show, such as a twin under coded light.

    Attributes
    ----------
    centre_px, a_px, b_px, covariance_px2
        As those of a `Measurement` that is phased.
    excess
        Twice the logarithm of the odds of the measurement against it.
    ambient
        What it says of the ambient light, where that is a parameter.
    """

    centre_px: FloatArray
    a_px: FloatArray
    b_px: FloatArray
    covariance_px2: FloatArray
    excess: float
    ambient: AmbientEstimate | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LightScore:
    """What one target says of the lamp's brightness in parts of the cycle (`labdaemon.blur.phase.light_check`).

    Attributes
    ----------
    information
        (n, n) of the corrections of n equal parts of the cycle, in parts of the lamp's full brightness.
    score
        (n,) its product with the corrections that explain the residuals best.
    constant_excess
        By how many squared standard deviations constant light explains the image less well than the code.
    response_sd
        (4, n) change of a and b by the corrections, where the fit does not know of them, along the axes of their
        covariance and in its standard deviations; None where that is not known.
    """

    information: FloatArray
    score: FloatArray
    constant_excess: float = 0.0
    response_sd: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """A target's motion in one frame (or one group of frames), in pixels.

    Attributes
    ----------
    target
        Its name.
    centre_px
        (2,) mean position over the exposure, x and y.
    a_px, b_px
        (2,) semi-axes as the module's docstring defines them.
    covariance_px2
        (6, 6) covariance of (x, y, ax, ay, bx, by); NaN where not measured.
    phased
        True when a and b carry the excitation's phase (signed), False for an orbit's axes.
    flags
        Statements about it, see `Flag`.
    defocus_px2
        Isotropic extra variance against the sharp frame (defocus), px², as used.
    chi2
        Mean squared normalised residual; 1 when the model holds.
    axes
        The same without its phase, where it is `phased` but the phase hardly shows.
    alternatives
        Other motions that the image does not exclude, or hardly so: cameras decide between them together.
    arc
        Where the phase hardly shows: the motions of which this one is the mean, each with its excess over the most
        likely one.
    light_scores
        Of each frame under coded light, what it says of the code.
    ambient
        What it says of the ambient light under coded light, where that is a parameter and the phase shows.
    rest
        Where it would be at rest, if that took part in the choice between its motions.
    """

    target: str
    centre_px: FloatArray
    a_px: FloatArray
    b_px: FloatArray
    covariance_px2: FloatArray
    phased: bool = False
    flags: frozenset[Flag] = field(default_factory=frozenset)
    defocus_px2: float = 0.0
    chi2: float = 1.0
    axes: Measurement | None = None
    alternatives: tuple[AlternativeMotion, ...] = ()
    arc: tuple[AlternativeMotion, ...] = ()
    light_scores: tuple[LightScore, ...] = ()
    ambient: AmbientEstimate | None = None
    rest: RestPlace | None = None

    @property
    def amplitude_px(self) -> float:
        """Major semi-axis of the orbit, zero to peak; NaN where not measured."""
        vectors = np.column_stack((self.a_px, self.b_px))
        return float(np.linalg.norm(vectors, 2)) if np.isfinite(vectors).all() else math.nan

    @property
    def sd_px(self) -> float:
        """Standard deviation of `amplitude_px`, to first order; NaN where not measured."""
        vectors = np.column_stack((self.a_px, self.b_px))
        if not np.isfinite(vectors).all():
            return math.nan
        left, _, right = np.linalg.svd(vectors)
        slope = np.concatenate((left[:, 0] * right[0, 0], left[:, 0] * right[0, 1]))
        return float(np.sqrt(max(slope @ self.covariance_px2[2:, 2:] @ slope, 0.0)))

    def __repr__(self) -> str:
        flags = f", flags {';'.join(sorted(self.flags))}" if self.flags else ""
        return f"<Measurement {self.target}: {self.amplitude_px:.3f} ± {self.sd_px:.3f} px{flags}>"


@dataclass(frozen=True, slots=True)
class Defocus:
    """Isotropic extra blur of a frame against the sharp one (defocus, shake), as its control targets tell it.

    Attributes
    ----------
    mean_px2, sd_px2
        Variance and its standard deviation, px². The mean may be negative (the sharp frame was the less sharp one).
    anisotropy_px2
        Bound of its anisotropy. Without control targets nothing measures it, and a motion whose square is not well
        above this bound counts as rest.
    sd_anisotropy_px2
        Standard deviation that it adds to a squared amplitude: more blur along the motion than across it reads as
        motion, less as a lack of it.
    """

    mean_px2: float = 0.0
    sd_px2: float = 0.1
    anisotropy_px2: float = 0.0
    sd_anisotropy_px2: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class InitialGuess:
    """Where to begin looking.

    Attributes
    ----------
    centre_px
        (2,) expected mean position in the frame.
    a_px, b_px
        (2,) expected motion; None lets the patch tell.
    """

    centre_px: FloatArray
    a_px: FloatArray | None = None
    b_px: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StaticMeasurement:
    """How a thing that does not move looks shifted and blurred against the sharp frame: the camera's doing.

    Attributes
    ----------
    target
        Its name.
    centre_px
        (2,) where it was in the sharp frame.
    shift_px
        (2,) shift against the sharp frame.
    defocus_px2
        Isotropic extra variance.
    covariance_px2
        (3, 3) covariance of (shift x, shift y, extra variance).
    flags
        `not_found`, `poor_fit` and so on.
    chi2
        Mean squared normalised residual.
    """

    target: str
    centre_px: FloatArray
    shift_px: FloatArray
    defocus_px2: float
    covariance_px2: FloatArray
    flags: frozenset[Flag] = field(default_factory=frozenset)
    chi2: float = 1.0


def match_guesses(
    sharps: Sequence[object], patches: Sequence[object], initial_guesses: Sequence[InitialGuess | None] | None
) -> Sequence[InitialGuess | None]:
    """One start a target, None where none was given.

    Raises
    ------
    UsageError
        Not one patch, and one start if any, for each target.
    """
    if len(sharps) != len(patches) or (initial_guesses is not None and len(initial_guesses) != len(sharps)):
        raise UsageError("give one patch (and one start, if any) for each sharp target")
    return initial_guesses if initial_guesses is not None else [None] * len(sharps)


def empty_measurement(target: str, flags: set[Flag]) -> Measurement:
    """A measurement without numbers."""
    nan = np.full(2, np.nan)
    return Measurement(target, nan, nan, nan, np.full((6, 6), np.nan), flags=frozenset(flags), chi2=float("nan"))


def with_relative_sd(measurement: Measurement, relative_sd: float) -> Measurement:
    """A measurement with an error of its amplitude in the covariance that no residual shows.

    Parameters
    ----------
    measurement
        As measured; without numbers it stays as it is.
    relative_sd
        Standard deviation of that error over the amplitude.
    """
    motion = np.concatenate((measurement.a_px, measurement.b_px))
    if relative_sd <= 0 or not np.isfinite(motion).all():
        return measurement
    covariance = measurement.covariance_px2.copy()
    covariance[2:, 2:] += relative_sd**2 * np.outer(motion, motion)
    axes = None if measurement.axes is None else with_relative_sd(measurement.axes, relative_sd)
    return replace(measurement, covariance_px2=covariance, axes=axes)
