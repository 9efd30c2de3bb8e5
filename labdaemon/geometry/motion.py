"""A target's motion as cameras see it and as it is: what geometry takes and gives.

Image quantities are pixels of the frame as taken (with lens distortion), pixel centres at integers. Object space is
right-handed, Z up, millimetres. ``d(t) = a sin(ωt) + b cos(ωt)`` about the mean; without phase a and b are the
orbit's major and minor semi-axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labdaemon.flags import Flag
from labdaemon.geometry.orbit_prior import AxisRatio
from labdaemon.rest_place import RestPlace

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ImageMotion:
    """A target's motion in one camera's frame.

    Attributes
    ----------
    mean_px, a_px, b_px
        (2,) each.
    covariance_px2
        (6, 6) of (x, y, ax, ay, bx, by).
    phased
        True when a and b are signed by the excitation's phase.
    axes
        The same without its phase, where that hardly shows.
    alternatives
        Other signed motions that the same image may show, such as twins under coded light.
    arc
        Where the phase hardly shows: the signed motions of which this one is the mean.
    rest
        Where it would be at rest, if that took part in the choice between its motions.
    excess
        Of an alternative: twice the logarithm of the odds against it.
    """

    mean_px: FloatArray
    a_px: FloatArray
    b_px: FloatArray
    covariance_px2: FloatArray
    phased: bool = False
    axes: ImageMotion | None = None
    alternatives: tuple[ImageMotion, ...] = ()
    arc: tuple[ImageMotion, ...] = ()
    rest: RestPlace | None = None
    excess: float = 0.0

    @property
    def row(self) -> tuple[ImageMotion, ...]:
        """All motions that the image may show."""
        return (*(self.arc or (self,)), *self.alternatives)


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMotion:
    """A target's motion in object space.

    Attributes
    ----------
    mean_mm, a_mm, b_mm
        (3,) each.
    covariance_mm2
        (9, 9) of (x, y, z, ax, ay, az, bx, by, bz); NaN rows and columns for what was not observed (the normal
        component with one camera).
    residual_ratio
        Runner-up's residual over the best one's, when ends had to be matched; None otherwise.
    flags
        `Flag.AMBIGUOUS` where the match is not settled.
    """

    mean_mm: FloatArray
    a_mm: FloatArray
    b_mm: FloatArray
    covariance_mm2: FloatArray
    residual_ratio: float | None = None
    flags: frozenset[Flag] = field(default_factory=frozenset)


@dataclass(frozen=True, slots=True, eq=False)
class IntersectedMotion:
    """A target's motion and what else it might be.

    Attributes
    ----------
    motion
        The best solution.
    alternative
        The runner-up that could not be excluded; None when the match is settled, or an orbit's two roots merge.
    resolved_by
        ``residual`` (two cameras), ``third camera``, ``phase``, ``common phase``, ``continuity``; empty where not
        settled.
    evidence
        Logarithm of the odds for the motion against its alternative, from the residuals alone.
    signed
        Whether both carry the excitation's phase.
    axis_ratio
        Of a signed motion that rays and images settle without a prior of the ratio; None of others.
    """

    motion: ObjectMotion
    alternative: ObjectMotion | None = None
    resolved_by: str = ""
    evidence: float = 0.0
    signed: bool = False
    axis_ratio: AxisRatio | None = None
