"""Transfer functions of a straight path whose waveform is not exactly a sinusoid over whole cycles.

By the Jacobi–Anger series exp(−iz sin θ) = Σ_k J_k(z) exp(−ikθ), z = 2π f·v, any exposure of a sinusoid has

    H = J0(z) + Σ_{k even} q_k J_k(z) − i Σ_{k odd} q_k J_k(z).

An exposure of Θ radians with the phase μ at its middle has q_k = 2 sin(kΘ/2)/(kΘ/2) · cos kμ for even k and · sin kμ
for odd k; whole cycles have none. A third harmonic, d = v·(sin θ + c sin 3θ + s cos 3θ), adds −c z J3(z) to first
order; s shows by its square only. All these are linear: one evaluation of the image at the whole-cycle solution says
which of them it asks for.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import special

from labdaemon.blur.motion import ExposureWindow
from labdaemon.blur.patch.pixels import ComplexArray, FloatArray
from labdaemon.blur.waveform import window_nodes

ORDERS = 10
"""Terms q_1 … q_ORDERS of the series: beyond, lens blur leaves nothing of J_k at the amplitudes that are fitted."""
TABLE_STEP, MAX_ARGUMENT = 0.01, 200.0
"""Step of the table of Bessel functions (linear interpolation is good to 1e-5), and its end."""


def series_transfer(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Transfer function by (vx, vy, β², q_1 … q_ORDERS, c) at β² = q = c = 0, and its derivatives.

    β is a minor axis, a quarter of a cycle later and across v: it is free, since a harmonic or a part cycle looks like
    a small one.

    Parameters
    ----------
    fx, fy
        (rows, columns) frequencies, cycles a pixel.
    p
        (ORDERS + 4,) only v counts: the function is meant for one look at the whole-cycle solution.
    """
    z = 2 * np.pi * (p[0] * fx + p[1] * fy)
    bessel = _bessel(np.asarray(z, np.float64))
    slope = -2 * np.pi * bessel[1]
    terms = [bessel[k] if k % 2 == 0 else -1j * bessel[k] for k in range(1, ORDERS + 1)]
    size = max(float(np.hypot(p[0], p[1])), 1e-12)
    across = 2 * np.pi * (p[0] * fy - p[1] * fx) / size
    minor = -(across**2) * (bessel[0] + bessel[2]) / 4
    slopes = np.stack([fx * slope, fy * slope, minor, *terms, -z * bessel[3]])
    return bessel[0].astype(np.complex128), slopes.astype(np.complex128)


@lru_cache(maxsize=1)
def _bessel_table() -> tuple[FloatArray, list[FloatArray]]:
    z = np.arange(0.0, MAX_ARGUMENT + TABLE_STEP, TABLE_STEP)
    return z, [np.asarray(special.jv(k, z), np.float64) for k in range(ORDERS + 1)]


def _bessel(z: FloatArray) -> list[FloatArray]:
    """J_0 … J_ORDERS; beyond the table the lens leaves nothing."""
    at, table = _bessel_table()
    size, sign = np.abs(z), np.where(z < 0, -1.0, 1.0)
    values = [np.interp(size, at, one) for one in table]
    return [one if k % 2 == 0 else sign * one for k, one in enumerate(values)]


def window_series(theta_rad: FloatArray, mu_rad: FloatArray) -> FloatArray:
    """(…, ORDERS) q of exposures of Θ radians with the phase μ at their middle; both broadcast."""
    theta, mu = np.broadcast_arrays(theta_rad, mu_rad)
    k = np.arange(1, ORDERS + 1)
    share = 2 * np.sinc(k * theta[..., None] / (2 * np.pi))
    angle = k * mu[..., None]
    result: FloatArray = share * np.where(k % 2 == 0, np.cos(angle), np.sin(angle))
    return result


def amplitude_error(theta_rad: FloatArray, mu_rad: FloatArray) -> FloatArray:
    """Relative error of a small amplitude that is measured as if over whole cycles: by the path's variance alone."""
    theta, mu = np.broadcast_arrays(theta_rad, mu_rad)
    mean = np.sinc(theta / (2 * np.pi)) * np.sin(mu)
    square = 0.5 - 0.5 * np.sinc(theta / np.pi) * np.cos(2 * mu)
    result: FloatArray = np.sqrt(2 * np.maximum(square - mean**2, 1e-6)) - 1
    return result


def free_window_transfer(fx: FloatArray, fy: FloatArray, p: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Transfer function of v·sin θ over an unknown exposure by (vx, vy, μ, Θ), and its derivatives.

    With e(τ) = exp(−2πi f·v sin(μ + τ)): ∂H/∂μ = (e(Θ/2) − e(−Θ/2))/Θ and ∂H/∂Θ = ((e(Θ/2) + e(−Θ/2))/2 − H)/Θ.
    """
    v, mu, theta = p[:2], float(p[2]), float(p[3])
    window = ExposureWindow(theta / (2 * np.pi), 1.0, mu - theta / 2)
    basis, weight = window_nodes(window, 3.0 + 1.1 * float(np.hypot(*v)))
    waveform = basis[0]
    along_x = np.exp(-2j * np.pi * v[0] * waveform[:, None] * fx[:1])
    along_y = np.exp(-2j * np.pi * v[1] * fy[:, :1] * waveform[None, :]) * weight
    transfer = along_y @ along_x
    moment = -2j * np.pi * ((along_y * waveform) @ along_x)

    def end(tau: float) -> ComplexArray:
        place = np.sin(mu + tau)
        return np.asarray(np.exp(-2j * np.pi * place * v[1] * fy[:, :1]) * np.exp(-2j * np.pi * place * v[0] * fx[:1]))

    last, first = end(theta / 2), end(-theta / 2)
    by_mu, by_theta = (last - first) / theta, ((last + first) / 2 - transfer) / theta
    return transfer, np.stack((fx * moment, fy * moment, by_mu, by_theta))
