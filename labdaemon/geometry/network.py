"""What a bundle adjustment adjusts: cameras, their images, points, and what is known of them beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray

IntArray = NDArray[np.intp]


class LensModel(Protocol):
    """An interior orientation that can be adjusted: `Lens` or `BrownLens`."""

    @property
    def parameters(self) -> FloatArray:
        """(9,) interior parameters."""
        ...

    def with_parameters(self, parameters: FloatArray) -> LensModel:
        """Give the same camera with other interior parameters."""
        ...

    def linearise(self, image_px: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, 2) residuals of pixels against ray slopes, their (n, 2, 2) and (n, 2, 9) derivatives, px."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Exterior orientation of one image: ``x_camera = rotation @ (x_object - position)``."""

    rotation: FloatArray
    position: FloatArray


@dataclass(frozen=True, slots=True)
class ScaleBar:
    """A known distance between two points (by index), with its standard deviation; units of the points."""

    first: int
    second: int
    length: float
    sd: float


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """All observations and starting values of an adjustment. Lengths are in any one unit (mm in this house).

    Attributes
    ----------
    lenses
        Cameras' interior orientations.
    poses, lens_of
        One an image, and the index of the lens it was taken with.
    points
        (p, 3) starting coordinates; those of control points are their surveyed ones.
    image, point
        (n,) indices of each observation's image and point.
    image_px, sd_px
        (n, 2) measured pixels, and (n,) or scalar standard deviation of a coordinate.
    control_sd
        (p, 3) standard deviation of surveyed coordinates: 0 holds one fixed, inf (the default) leaves it free.
    bars
        Known distances.
    free_interior
        For each lens (9,) which of its parameters are adjusted; None for none of any.
    datum
        Free network: inner constraints on the points in place of control (position, attitude, and without bars the
        scale, are those of the starting coordinates).
    """

    lenses: tuple[LensModel, ...]
    poses: tuple[Pose, ...]
    lens_of: IntArray
    points: FloatArray
    image: IntArray
    point: IntArray
    image_px: FloatArray
    sd_px: FloatArray | float = 1.0
    control_sd: FloatArray | None = None
    bars: tuple[ScaleBar, ...] = ()
    free_interior: tuple[NDArray[np.bool_], ...] | None = None
    datum: bool = field(default=False)

    @property
    def weights(self) -> FloatArray:
        """(n,) 1/variance of each observation's coordinates."""
        return np.broadcast_to(np.asarray(self.sd_px, dtype=float), (len(self.image),)) ** -2.0

    @property
    def survey_sd(self) -> FloatArray:
        """(p, 3) standard deviation of what is known of each point."""
        if self.control_sd is None:
            return np.full(self.points.shape, np.inf)
        return np.asarray(self.control_sd, dtype=float)

    @property
    def interior_columns(self) -> tuple[IntArray, ...]:
        """For each lens, which of its nine parameters are adjusted."""
        if self.free_interior is None:
            return tuple(np.zeros(0, dtype=np.intp) for _ in self.lenses)
        return tuple(np.flatnonzero(mask) for mask in self.free_interior)


def check_network(network: Network, names: Sequence[str]) -> None:
    """Refuse what cannot be adjusted, naming it.

    Parameters
    ----------
    network
        The observations.
    names
        (p,) names of the points.

    Raises
    ------
    DataError
        A free point seen in fewer than two images, an image with fewer than three points, or no datum.
    """
    rays = np.bincount(network.point, minlength=len(network.points))
    known = np.isfinite(network.survey_sd).all(axis=1)
    undetermined = np.flatnonzero((rays < 2) & ~known)
    if undetermined.size:
        listing = ", ".join(names[i] for i in undetermined[:10].tolist())
        raise DataError(f"seen in fewer than two images, so that their place is not fixed: {listing}")
    observed = np.bincount(network.image, minlength=len(network.poses))
    if np.any(observed < 3):
        raise DataError(f"image {int(np.argmin(observed)) + 1} shows only {observed.min()} points: three are needed")
    if not network.datum and np.isfinite(network.survey_sd).sum() + len(network.bars) < 7:
        raise DataError("neither control points nor a free network: nothing says where and how large the object is")
