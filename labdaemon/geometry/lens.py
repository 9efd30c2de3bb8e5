"""Interior orientation: from a ray in front of a camera to a pixel of its frame, and exactly back.

The lens model is OpenCV's: a ray (x, y, 1) in the camera's frame (x right, y down, z forward) meets the sensor at

    x_d = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y_d = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y,      r² = x² + y²

and the pixel is ``focal_px * (x_d, y_d) + principal_point_px``, pixel centres at integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from labdaemon.errors import DataError
from labdaemon.geometry.motion import FloatArray

TOLERANCE_PX = 1e-10
"""`Lens.undistort` iterates until the pixel is met this closely (or to the last bit of a double)."""

INTERIOR_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""Order of the interior parameters in Jacobians and covariances."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera's interior orientation in OpenCV's model.

    Attributes
    ----------
    image_size
        (width, height) of the frame that the model belongs to, pixels.
    focal_px
        (fx, fy).
    principal_point_px
        (cx, cy), pixel centres at integers.
    distortion
        (k1, k2, p1, p2, k3), dimensionless.
    """

    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (*self.focal_px, *self.principal_point_px, *self.distortion)
        if len(self.distortion) != 5 or not np.all(np.isfinite(numbers)):
            raise DataError("a lens needs two focal lengths, a principal point and k1 k2 p1 p2 k3, all finite")
        if min(self.focal_px) <= 0 or min(self.image_size) <= 0:
            raise DataError("a lens needs a positive focal length and image size")

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def parameters(self) -> FloatArray:
        """(9,) in the order of `INTERIOR_NAMES`."""
        return np.array([*self.focal_px, *self.principal_point_px, *self.distortion])

    def with_parameters(self, parameters: FloatArray) -> Lens:
        """Give the same camera with other interior parameters (9,), in the order of `INTERIOR_NAMES`."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = (float(value) for value in parameters)
        return Lens(self.image_size, (fx, fy), (cx, cy), (k1, k2, p1, p2, k3))

    @property
    def fold_radius(self) -> float:
        """Ray slope r at which the radial polynomial turns back; inf if it never does.

        Beyond it two rays share one pixel, so nothing there can be undistorted.
        """
        k1, k2, _, _, k3 = self.distortion
        return _fold_radius(k1, k2, k3)

    @property
    def covers_image(self) -> bool:
        """True when every pixel of the frame belongs to exactly one ray."""
        width, height = self.image_size
        x, y = np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33)
        edge = np.concatenate(
            [
                np.column_stack([x, np.zeros(33)]),
                np.column_stack([x, np.full(33, height - 1.0)]),
                np.column_stack([np.zeros(33), y]),
                np.column_stack([np.full(33, width - 1.0), y]),
            ]
        )
        return bool(np.all(np.isfinite(self.undistort(edge))))

    def contains(self, image_px: FloatArray) -> NDArray[np.bool_]:
        """Tell for each of (n, 2) pixels whether it lies in the frame; (n,) bool."""
        width, height = self.image_size
        x, y = image_px[..., 0], image_px[..., 1]
        inside: NDArray[np.bool_] = (x >= -0.5) & (y >= -0.5) & (x <= width - 0.5) & (y <= height - 0.5)
        return inside

    def distort(self, slopes: FloatArray) -> FloatArray:
        """Pixels of rays.

        Parameters
        ----------
        slopes
            (n, 2) ray slopes x/z, y/z.

        Returns
        -------
        FloatArray
            (n, 2) pixels; NaN beyond the fold of a strong distortion.
        """
        x, y = slopes[..., 0], slopes[..., 1]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        distorted = np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )
        pixels = distorted * np.array(self.focal_px) + np.array(self.principal_point_px)
        return cast(FloatArray, np.where((r2 < self.fold_radius**2)[..., None], pixels, np.nan))

    def distort_jacobian(self, slopes: FloatArray) -> FloatArray:
        """(n, 2, 2) derivative of `distort` by the slopes, px."""
        x, y = slopes[..., 0], slopes[..., 1]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / d(r²) * 2
        jacobian = np.empty((*slopes.shape[:-1], 2, 2))
        jacobian[..., 0, 0] = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        jacobian[..., 0, 1] = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        jacobian[..., 1, 0] = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        jacobian[..., 1, 1] = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
        return cast(FloatArray, jacobian * np.array(self.focal_px)[:, None])

    def parameter_jacobian(self, slopes: FloatArray) -> FloatArray:
        """(n, 2, 9) derivative of `distort` by the interior parameters, in the order of `INTERIOR_NAMES`."""
        x, y = slopes[..., 0], slopes[..., 1]
        fx, fy = self.focal_px
        r2 = x * x + y * y
        jacobian = np.zeros((*slopes.shape[:-1], 2, 9))
        distorted = (self.distort(slopes) - np.array(self.principal_point_px)) / np.array(self.focal_px)
        jacobian[..., 0, 0] = distorted[..., 0]
        jacobian[..., 1, 1] = distorted[..., 1]
        jacobian[..., 0, 2] = 1.0
        jacobian[..., 1, 3] = 1.0
        for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
            jacobian[..., 0, column] = fx * x * power
            jacobian[..., 1, column] = fy * y * power
        jacobian[..., 0, 6] = fx * 2.0 * x * y
        jacobian[..., 1, 6] = fy * (r2 + 2.0 * y * y)
        jacobian[..., 0, 7] = fx * (r2 + 2.0 * x * x)
        jacobian[..., 1, 7] = fy * 2.0 * x * y
        return jacobian

    def linearise(self, image_px: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of measured pixels against rays, as a bundle adjustment needs them.

        Returns
        -------
        tuple
            (n, 2) measured minus computed pixels of (n, 2) pixels and slopes, and the derivatives of the computed ones
            by the slopes (n, 2, 2) and by the interior parameters (n, 2, 9).
        """
        return image_px - self.distort(slopes), self.distort_jacobian(slopes), self.parameter_jacobian(slopes)

    def undistort(self, image_px: FloatArray) -> FloatArray:
        """Ray slopes of pixels, by Newton's method from the inverse of the radial part.

        Parameters
        ----------
        image_px
            (n, 2) pixels.

        Returns
        -------
        FloatArray
            (n, 2) slopes x/z, y/z with ``distort(slopes)`` equal to `image_px` within 1e-10 px; NaN where the
            distortion folds over, so that no single ray belongs to the pixel.
        """
        focal, centre = np.array(self.focal_px), np.array(self.principal_point_px)
        image_px = np.asarray(image_px, dtype=float)
        target = (image_px - centre) / focal
        slopes = self._radial_start(target)
        tolerance = np.maximum(TOLERANCE_PX, 8.0 * np.spacing(np.abs(image_px).max(initial=1.0)))
        for _ in range(30):
            miss = image_px - self.distort(slopes)
            if not np.any(np.abs(miss) > tolerance):
                break
            jacobian = self.distort_jacobian(slopes)
            det = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
            det = np.where(det > 0, det, np.nan)
            step_x = (jacobian[..., 1, 1] * miss[..., 0] - jacobian[..., 0, 1] * miss[..., 1]) / det
            step_y = (jacobian[..., 0, 0] * miss[..., 1] - jacobian[..., 1, 0] * miss[..., 0]) / det
            slopes = slopes + np.stack([step_x, step_y], axis=-1)
        met = np.all(np.abs(image_px - self.distort(slopes)) <= tolerance, axis=-1)
        return cast(FloatArray, np.where(met[..., None], slopes, np.nan))

    def _radial_start(self, target: FloatArray) -> FloatArray:
        """Invert the radial polynomial alone by a table; NaN beyond the radius that it reaches."""
        k1, k2, _, _, k3 = self.distortion
        wanted = np.hypot(target[..., 0], target[..., 1])
        # Without a fold the polynomial grows at least as slowly as 1/3 of the ray's slope over any real frame.
        reach = min(self.fold_radius * (1.0 - 1e-9), 4.0 * float(np.nanmax(wanted, initial=0.0)) + 1.0)
        radius = np.linspace(0.0, reach, 4001)
        r2 = radius**2
        table = radius * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        start = np.interp(wanted, table, radius, right=np.nan)
        # Tangential terms may carry a pixel slightly past the radial limit: start just inside and let Newton decide.
        start = np.where(np.isnan(start) & (wanted < 1.02 * table[-1]), 0.98 * reach, start)
        scale = np.divide(start, wanted, out=np.ones_like(wanted), where=wanted > 0)
        return target * scale[..., None]


@lru_cache(maxsize=64)
def _fold_radius(k1: float, k2: float, k3: float) -> float:
    """Smallest positive root of 1 + 3 k1 r² + 5 k2 r⁴ + 7 k3 r⁶; inf for none."""
    # In 1/r² the leading coefficient is 1, so that a vanishing k3 does no harm.
    roots = np.roots([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
    real = roots[np.abs(roots.imag) <= 1e-9 * np.abs(roots)].real
    largest = float(real.max(initial=0.0))
    return largest**-0.5 if largest > 1e-12 else float("inf")
