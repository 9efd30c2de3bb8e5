"""Brown's backward lens model, as PhotoModeler and photogrammetric bundle programs use it, and OpenCV's forward one.

Backward means that corrections are added to *measured* image coordinates:

    x = ((u + 1/2) h − px) (1 + affinity),   y = py − (v + 1/2) h             mm on the sensor, x right, y up
    x' = x + x (K1 r² + K2 r⁴ + K3 r⁶) + P1 (r² + 2 x²) + 2 P2 x y
    y' = y + y (K1 r² + K2 r⁴ + K3 r⁶) + P2 (r² + 2 y²) + 2 P1 x y,                r² = x² + y²

and the ray through the pixel (u, v), pixel centres at integers, has the slopes x'/c to the right and −y'/c down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from labdaemon.errors import DataError
from labdaemon.geometry.lens import Lens
from labdaemon.geometry.motion import FloatArray
from labdaemon.least_squares import damped_step, minimise


@dataclass(frozen=True, slots=True)
class BrownLens:
    """A camera's interior orientation in Brown's backward model.

    Attributes
    ----------
    image_size
        (width, height), pixels.
    pixel_mm
        Height of a pixel, mm; its width is ``pixel_mm * (1 + affinity)``.
    camera_constant_mm
        c.
    principal_point_mm
        (px, py) from the outer corner of the top-left pixel, right and down, in pixels of `pixel_mm` both ways.
    affinity
        Dimensionless.
    radial
        (K1, K2, K3) in mm⁻², mm⁻⁴, mm⁻⁶.
    decentring
        (P1, P2) in mm⁻¹.
    """

    image_size: tuple[int, int]
    pixel_mm: float
    camera_constant_mm: float
    principal_point_mm: tuple[float, float]
    affinity: float = 0.0
    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    decentring: tuple[float, float] = (0.0, 0.0)

    @property
    def parameters(self) -> FloatArray:
        """(9,) c, px, py, affinity, K1, K2, K3, P1, P2: their order in Jacobians and covariances."""
        return np.array(
            [self.camera_constant_mm, *self.principal_point_mm, self.affinity, *self.radial, *self.decentring]
        )

    def with_parameters(self, parameters: FloatArray) -> BrownLens:
        """Give the same camera with other interior parameters (9,), in the order of `parameters`."""
        c, px, py, affinity, k1, k2, k3, p1, p2 = (float(value) for value in parameters)
        return BrownLens(self.image_size, self.pixel_mm, c, (px, py), affinity, (k1, k2, k3), (p1, p2))

    def correct(self, image_px: FloatArray) -> FloatArray:
        """(n, 2) corrected sensor coordinates (x', y'), mm, y up, of (n, 2) pixels."""
        x, y = self._sensor(image_px)
        k1, k2, k3 = self.radial
        p1, p2 = self.decentring
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y,
                y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y,
            ],
            axis=-1,
        )

    def undistort(self, image_px: FloatArray) -> FloatArray:
        """(n, 2) ray slopes x/z, y/z (y down) of (n, 2) pixels: the model's direct direction."""
        slopes: FloatArray = self.correct(image_px) * np.array([1.0, -1.0]) / self.camera_constant_mm
        return slopes

    def distort(self, slopes: FloatArray) -> FloatArray:
        """(n, 2) pixels of ray slopes, by Newton's method; NaN where it finds none."""
        wanted = np.asarray(slopes, dtype=float)
        shape = np.array([1.0 + self.affinity, 1.0]) * self.pixel_mm
        pixels: FloatArray = wanted * self.camera_constant_mm / shape
        pixels = pixels + np.array(self.principal_point_mm) / self.pixel_mm - 0.5
        for _ in range(50):
            miss = wanted - self.undistort(pixels)
            jacobian = self._correction_by_pixel(pixels) * np.array([[1.0], [-1.0]]) / self.camera_constant_mm
            det = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
            det = np.where(det > 0, det, np.nan)
            step = np.stack(
                [
                    (jacobian[..., 1, 1] * miss[..., 0] - jacobian[..., 0, 1] * miss[..., 1]) / det,
                    (jacobian[..., 0, 0] * miss[..., 1] - jacobian[..., 1, 0] * miss[..., 0]) / det,
                ],
                axis=-1,
            )
            pixels = pixels + step
            if not np.any(np.abs(step) > 1e-10):
                break
        return pixels

    def linearise(self, image_px: FloatArray, slopes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of measured pixels against rays, as a bundle adjustment needs them.

        Parameters
        ----------
        image_px, slopes
            (n, 2) measured pixels and (n, 2) slopes of the rays to the points.

        Returns
        -------
        tuple
            (n, 2) corrected minus computed coordinates in units of `pixel_mm`, x right and y up; (n, 2, 2) derivative
            of what is subtracted by the slopes, (n, 2, 9) by the interior parameters (both with the sign of a
            computed value, so that ``residual ≈ derivative @ change``).
        """
        x, y = self._sensor(image_px)
        r2 = x * x + y * y
        computed = slopes * np.array([1.0, -1.0]) * self.camera_constant_mm
        residual = (self.correct(image_px) - computed) / self.pixel_mm
        by_slope = np.zeros((*slopes.shape, 2))
        by_slope[..., 0, 0], by_slope[..., 1, 1] = self.camera_constant_mm, -self.camera_constant_mm
        by_interior = np.zeros((*slopes.shape, 9))
        by_interior[..., 0, 0], by_interior[..., 1, 0] = slopes[..., 0], -slopes[..., 1]
        by_sensor = self._correction_by_sensor(x, y)
        # Corrections stand on the measured side: their derivative enters with the opposite sign.
        by_interior[..., :, 1] = by_sensor[..., :, 0] * (1.0 + self.affinity)
        by_interior[..., :, 2] = -by_sensor[..., :, 1]
        by_interior[..., :, 3] = -by_sensor[..., :, 0] * (x / (1.0 + self.affinity))[..., None]
        for column, power in ((4, r2), (5, r2**2), (6, r2**3)):
            by_interior[..., 0, column], by_interior[..., 1, column] = -x * power, -y * power
        by_interior[..., 0, 7], by_interior[..., 1, 7] = -(r2 + 2.0 * x * x), -2.0 * x * y
        by_interior[..., 0, 8], by_interior[..., 1, 8] = -2.0 * x * y, -(r2 + 2.0 * y * y)
        return residual, by_slope / self.pixel_mm, by_interior / self.pixel_mm

    def _sensor(self, image_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured coordinates on the sensor from the principal point, mm, x right and y up."""
        x = ((image_px[..., 0] + 0.5) * self.pixel_mm - self.principal_point_mm[0]) * (1.0 + self.affinity)
        y = self.principal_point_mm[1] - (image_px[..., 1] + 0.5) * self.pixel_mm
        return x, y

    def _correction_by_sensor(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """(n, 2, 2) derivative of (x', y') by (x, y)."""
        k1, k2, k3 = self.radial
        p1, p2 = self.decentring
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        jacobian = np.empty((*x.shape, 2, 2))
        jacobian[..., 0, 0] = radial + x * x * slope + 6.0 * p1 * x + 2.0 * p2 * y
        jacobian[..., 0, 1] = jacobian[..., 1, 0] = x * y * slope + 2.0 * p1 * y + 2.0 * p2 * x
        jacobian[..., 1, 1] = radial + y * y * slope + 6.0 * p2 * y + 2.0 * p1 * x
        return jacobian

    def _correction_by_pixel(self, image_px: FloatArray) -> FloatArray:
        """(n, 2, 2) derivative of (x', y') by the pixel, mm/px."""
        x, y = self._sensor(image_px)
        by_pixel: FloatArray = self._correction_by_sensor(x, y) * np.array([1.0 + self.affinity, -1.0]) * self.pixel_mm
        return by_pixel


@dataclass(frozen=True, slots=True, eq=False)
class _LensFit:
    """A lens against pixels: (n, 9) derivatives by its parameters and (n,) what it misses, px, where both are known."""

    lens: Lens
    design: FloatArray
    miss: FloatArray

    @classmethod
    def of(cls, lens: Lens, pixels: FloatArray, slopes: FloatArray) -> _LensFit:
        """Linearise a lens at rays of these slopes (n, 2), which belong to `pixels` (n, 2)."""
        design = lens.parameter_jacobian(slopes).reshape(-1, 9)
        miss = (pixels - lens.distort(slopes)).ravel()
        usable = np.isfinite(miss) & np.isfinite(design).all(axis=1)
        return cls(lens, design[usable], miss[usable])

    @property
    def cost(self) -> float:
        """Mean squared miss, px²: a mean, since a step may bring rays into the model; inf where hardly any is in it."""
        return float(self.miss @ self.miss) / len(self.miss) if len(self.miss) > len(self.design.T) else math.inf


def forward_from_backward(brown: BrownLens) -> tuple[Lens, float]:
    """OpenCV's model of a lens given in Brown's.

    Neither polynomial is the other's inverse, so the coefficients are fitted over a grid of the whole frame.

    Returns
    -------
    tuple
        The lens, and the largest distance between the two models in the frame, px.

    Raises
    ------
    DataError
        No lens of OpenCV's model comes near.
    """
    pixels = _grid(brown.image_size)
    slopes = brown.undistort(pixels)
    width, height = brown.pixel_mm * (1.0 + brown.affinity), brown.pixel_mm
    focal = (brown.camera_constant_mm / width, brown.camera_constant_mm / height)
    centre = (brown.principal_point_mm[0] / height - 0.5, brown.principal_point_mm[1] / height - 0.5)
    lens = Lens(brown.image_size, focal, centre)
    nothing = "this lens has no counterpart in OpenCV's model: check its coefficients and units"

    def try_step(here: _LensFit, damping: float) -> tuple[_LensFit | None, bool]:
        step = damped_step(here.design.T @ here.design, here.design.T @ here.miss, damping)
        is_small = bool(np.all(np.abs(step) <= 1e-12 * (1.0 + np.abs(here.lens.parameters))))
        try:
            return _LensFit.of(here.lens.with_parameters(here.lens.parameters + step), pixels, slopes), is_small
        except DataError:  # a shorter step may stay within what a lens can be
            return None, is_small

    lens = minimise(_LensFit.of(lens, pixels, slopes), try_step, max_steps=40).at.lens
    worst = float(np.abs(pixels - lens.distort(slopes)).max())
    if not worst < 0.01 * max(brown.image_size):
        raise DataError(nothing)
    return lens, worst


def _grid(image_size: tuple[int, int]) -> FloatArray:
    """(n, 2) pixels evenly over a frame, its edges included."""
    x, y = np.meshgrid(np.linspace(0, image_size[0] - 1, 41), np.linspace(0, image_size[1] - 1, 31))
    return np.column_stack([x.ravel(), y.ravel()])
