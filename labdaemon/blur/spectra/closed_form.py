"""Closed-form spectra: the ellipse, the lens, the pixel, the motion.

All are continuous Fourier transforms ``M(f) = ∫ m(x) exp(−2πi f·x) dx`` with f in cycles a pixel.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.spectra.bessel import j0_j1


def ellipse_spectrum(fx: FloatArray, fy: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Spectrum of an ellipse of unit darkness, centred at the origin, and its derivatives.

    The ellipse is the image of the unit disc under the symmetric matrix Q = [[q0, q1], [q1, q2]] (px). Its spectrum is
    det Q · J1(2πρ)/ρ, ρ = |Q f|; a circle of radius R has Q = R·I.

    Returns
    -------
    spectrum, derivatives
        (...), and (3, ...) by q0, q1, q2.
    """
    ux, uy = q[0] * fx + q[1] * fy, q[1] * fx + q[2] * fy
    rho = np.hypot(ux, uy)
    safe = np.maximum(rho, 1e-9)
    z = 2 * np.pi * safe
    j1 = special.j1(z)
    det = q[0] * q[2] - q[1] ** 2
    jinc = j1 / safe
    slope = -2 * np.pi * (2 * j1 / z - special.j0(z)) / safe**2 * det  # d(jinc)/dρ · det / ρ
    derivatives = np.empty((3, *fx.shape))
    derivatives[0] = q[2] * jinc + slope * ux * fx
    derivatives[1] = -2 * q[1] * jinc + slope * (ux * fy + uy * fx)
    derivatives[2] = q[0] * jinc + slope * uy * fy
    return det * jinc, derivatives


def diffraction_transfer(f: FloatArray, width_px: float) -> FloatArray:
    """Transfer function of a diffraction-limited round aperture.

    (2/π)(acos ν − ν sqrt(1−ν²)) with ν = f·λN; `width_px` is λN, wavelength times f-number, in pixels.
    """
    nu = np.minimum(np.abs(f) * width_px, 1.0)
    result: FloatArray = (2 / np.pi) * (np.arccos(nu) - nu * np.sqrt(1 - nu**2))
    return result


def diffraction_derivative(f: FloatArray, width_px: float) -> FloatArray:
    """Derivative of `diffraction_transfer` by its width: −(4/π) f sqrt(1−ν²)."""
    nu = np.minimum(np.abs(f) * width_px, 1.0)
    result: FloatArray = -(4 / np.pi) * np.abs(f) * np.sqrt(1 - nu**2)
    return result


def gaussian_transfer(f2: FloatArray, variance_px2: float) -> FloatArray:
    """Transfer function exp(−2π² σ² f²) of a Gaussian; a negative variance sharpens."""
    # Steps on the way of a fit that goes wrong may ask for any sharpening; e¹² of it is as wrong as more, and its
    # squares can still be summed in single precision.
    result: FloatArray = np.exp(np.minimum(-2 * np.pi**2 * variance_px2 * f2, 12.0))
    return result


def pixel_transfer(fx: FloatArray, fy: FloatArray) -> FloatArray:
    """Transfer function of a square pixel."""
    result: FloatArray = np.sinc(fx) * np.sinc(fy)
    return result


def orbit_transfer(fx: FloatArray, fy: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Transfer function of an elliptical orbit over whole cycles, by its second moment.

    J0(z), z² = 4π² fᵀMf, with M = aaᵀ + bbᵀ = [[m0, m1], [m1, m2]] (px²). It is analytic in M, so that nothing special
    happens at rest; for a negative fᵀMf, which noise can ask for there, it continues as I0.

    Returns
    -------
    transfer, derivatives
        (...), and (3, ...) by m0, m1, m2.
    """
    squares = np.empty((3, *fx.shape), dtype=fx.dtype)
    squares[0], squares[1], squares[2] = fx * fx, 2 * fx * fy, fy * fy
    m0, m1, m2 = (float(4 * np.pi**2 * m) for m in moment)
    z2 = m0 * squares[0] + m1 * squares[1] + m2 * squares[2]
    z = np.sqrt(np.abs(z2))
    j0, j1 = j0_j1(z)
    ratio = np.divide(j1, z, out=np.full_like(z, 0.5), where=z > 1e-4)
    below = z2 < 0
    if np.any(below):
        zb = np.minimum(z[below], 20.0)
        j0[below] = special.i0(zb)
        ratio[below] = np.where(zb > 1e-4, special.i1(zb) / np.maximum(zb, 1e-30), 0.5)
    squares *= -2 * np.pi**2 * ratio  # dJ0/d(z²) = −J1(z)/(2z)
    return j0, squares


def bounded_orbit_transfer(fx: FloatArray, fy: FloatArray, moment: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`orbit_transfer` with another continuation where fᵀMf is negative: 1 + u/(1 + u), u = π²|fᵀMf|.

    Value and slope at rest are the same. I0 grows without limit, and amplifies the noise of a sampled target at
    frequencies where the target has no texture.
    """
    squares = np.stack((fx * fx, 2 * fx * fy, fy * fy))
    m0, m1, m2 = (float(m) for m in moment)
    quadratic = m0 * squares[0] + m1 * squares[1] + m2 * squares[2]
    z = 2 * np.pi * np.sqrt(np.maximum(quadratic, 0))
    j0, j1 = j0_j1(z)
    u = np.pi**2 * np.maximum(-quadratic, 0)
    transfer = np.where(quadratic < 0, 1 + u / (1 + u), j0)
    ratio = np.divide(j1, z, out=np.full_like(z, 0.5), where=z > 1e-4)
    slope = np.where(quadratic < 0, -(np.pi**2) / (1 + u) ** 2, -2 * np.pi**2 * ratio)
    return transfer.astype(fx.dtype), (squares * slope).astype(fx.dtype)


def straight_transfer(fx: FloatArray, fy: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Transfer function J0(2π f·a) of a straight sinusoid over whole cycles, and its derivatives by ax and ay."""
    z = float(2 * np.pi * a[0]) * fx + float(2 * np.pi * a[1]) * fy
    j0, j1 = j0_j1(np.abs(z))
    slope = -2 * np.pi * j1 * np.sign(z)
    derivatives = np.empty((2, *z.shape), dtype=z.dtype)
    np.multiply(slope, fx, out=derivatives[0])
    np.multiply(slope, fy, out=derivatives[1])
    return j0, derivatives


def blurred_orbit_transfer(fx: FloatArray, fy: FloatArray, variance_px2: float, moment: FloatArray) -> FloatArray:
    """Transfer function of a motion with second moment aaᵀ + bbᵀ = (m0, m1, m2), over whole cycles, and a Gaussian."""
    fx2, fy2 = fx * fx, fy * fy
    z2 = 4 * np.pi**2 * (moment[0] * fx2 + (2 * moment[1] * fy) * fx + moment[2] * fy2)
    result: FloatArray = special.j0(np.sqrt(np.maximum(z2, 0.0)))
    return result * (gaussian_transfer(fx2, variance_px2) * gaussian_transfer(fy2, variance_px2))
