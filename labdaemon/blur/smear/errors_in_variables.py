"""The fit of a template that has noise of its own: errors in variables.

A textured patch is modelled as B = H(p)*T, where the sharp image T = S + n1 has noise like the blurred one, B = H*S +
n2. The residual is n2 − H*n1: its variance s²·(1 + ρ²·t(p)/N) depends on the parameters, where t is the mean of |H|²,
N the number of sharp frames in the mean and ρ the contrast of the blurred frame over the sharp one's. Least squares
lowers it by more blur, and reads motion at rest. The cost here is

    F(p) = Q(p) / D(p),    Q = Σ w·residual²,    D = 1 + ρ²·t(p)/N

whose expectation is least at the true parameters whatever the noise is (total least squares; Fuller 1987,
Measurement Error Models). The derivatives of the image contain the noise as well, so that JᵀJ overstates the
information: the noise's share, W·s²ρ²/N·mean(H_i·H_j), is subtracted. A direction in which nothing is left has no
texture. The covariance is that of the score: A⁻¹BA⁻¹, with the products of the two noises in B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg

from labdaemon.blur.patch.colour_planes import merge_planes
from labdaemon.blur.patch.illumination import illumination_derivatives, render_illumination
from labdaemon.blur.patch.pixels import BoolArray, ComplexArray, FloatArray
from labdaemon.blur.settings import UNCERTAINTY
from labdaemon.blur.sharp.textured_patch import TexturedPatch
from labdaemon.blur.smear.fast_forward_model import fast_forward_model
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.reduced_equations import Solution
from labdaemon.blur.solver.solve import DarknessModel
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.texture_settings import TEXTURE


@dataclass(frozen=True, slots=True, eq=False)
class TransferMoments:
    """What a blur does to white noise: H and its derivatives over the band that the samples fill.

    Attributes
    ----------
    transfer
        (f,) H with the relative contrast; complex where the exposure is not of whole cycles.
    slopes
        (m, f) derivatives by the parameters; those by x and y only turn the phase.
    """

    transfer: ComplexArray
    slopes: ComplexArray

    @property
    def power(self) -> FloatArray:
        """(f,) |H|²."""
        return _squared(self.transfer)

    @property
    def power_slopes(self) -> FloatArray:
        """(m, f) half the derivatives of |H|²."""
        result: FloatArray = np.real(self.slopes * np.conj(self.transfer))
        return result

    @property
    def through(self) -> float:
        """Mean |H|²."""
        return float(np.mean(self.power))

    @property
    def through_slopes(self) -> FloatArray:
        """(m,) derivatives of the mean |H|²."""
        result: FloatArray = 2 * np.mean(self.power_slopes, axis=1)
        return result

    @property
    def bends(self) -> FloatArray:
        """(m, m) mean products of the derivatives."""
        return _products(self.slopes) / len(self.transfer)


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedEquations:
    """Cost, score and information at one set of parameters; the last one is the relative contrast.

    Attributes
    ----------
    cost, widening
        F and D.
    score, information
        (m,) and (m, m), without the noise's share, not yet divided by the noise's power.
    raw_information
        (m, m) JᵀJ with that share.
    noise_power
        s², in units of the weights' variance.
    template_share
        ρ²/N.
    residual, jacobian
        (n, h, w) and (m, n, h, w), weighted, illumination eliminated.
    moments
        What the blur does to noise.
    pixels
        Number of independent residuals.
    """

    cost: float
    widening: float
    score: FloatArray
    information: FloatArray
    raw_information: FloatArray
    noise_power: float
    template_share: float
    residual: FloatArray
    jacobian: FloatArray
    moments: TransferMoments
    pixels: int


def transfer_moments(
    problem: FitProblem, form: TexturedPatch, motion: TransferFunction, p: FloatArray, contrast: float
) -> TransferMoments:
    """H and its derivatives at parameters p, for white noise."""
    grid, k = problem.grid, problem.shape_count
    band = np.abs(grid.fx) + np.abs(grid.fy) < 0.5 if len(form.channel) > 1 else np.ones(grid.fx.shape, dtype=bool)
    return _moments_at(grid.fx, grid.fy, k, motion, p, contrast, band)


def _moments_at(
    fx: FloatArray,
    fy: FloatArray,
    k: int,
    motion: TransferFunction,
    p: FloatArray,
    contrast: float,
    band: BoolArray | None = None,
) -> TransferMoments:
    """The same on a grid of frequencies, (rows, columns) each, or on those of a `band` of it."""
    moved, by_motion = (np.asarray(one) for one in motion(fx, fy, p[3 + k :]))
    used = np.ones(fx.shape, dtype=bool) if band is None else band
    fx, fy, moved, by_motion = fx[used], fy[used], moved[used], by_motion[:, used]
    f2 = fx**2 + fy**2
    focus = contrast * closed_form.gaussian_transfer(f2, float(p[2]))
    whole = np.asarray(moved * focus, np.complex128)
    slopes = np.zeros((len(p) + 1, fx.size), np.complex128)
    slopes[0], slopes[1] = -2j * np.pi * fx * whole, -2j * np.pi * fy * whole
    slopes[2] = -2 * np.pi**2 * f2 * whole
    if k >= 2:
        slopes[3:5] = -whole / 2  # of −∂(xT)/∂x: its symmetric part
    slopes[3 + k : -1] = by_motion * focus
    slopes[-1] = whole / contrast
    return TransferMoments(whole, slopes)


def _squared(values: ComplexArray) -> FloatArray:
    result: FloatArray = values.real**2 + values.imag**2
    return result


def _products(rows: ComplexArray, weight: FloatArray | float = 1.0) -> FloatArray:
    """(m, m) real parts of the products of rows, summed with a weight."""
    result: FloatArray = np.real((rows * weight) @ np.conj(rows.T))
    return result


def blur_power(motion: TransferFunction, k: int, p: FloatArray, fx: FloatArray, fy: FloatArray) -> FloatArray:
    """(f,) |H|² at frequencies (f,) each, at parameters p, of which `k` are the shape's."""
    moved, _ = motion(fx[None], fy[None], p[3 + k :])
    focus = closed_form.gaussian_transfer(fx**2 + fy**2, float(p[2]))
    return _squared(np.asarray(moved, np.complex128)[0] * focus)


def texture_depth(light: FloatArray) -> float:
    """Brightness of the blurred frame, DN, of which the texture's darkness is a part, by (n, 4) light of its planes."""
    return float(np.mean(np.abs(light[:, 0] * light[:, 3]))) if len(light) else 0.0


def template_share(form: TexturedPatch, light: FloatArray) -> float:
    """Variance of the template's noise over that of the blurred frame, ρ²/N, by (n, 4) light of planes in use."""
    return (texture_depth(light) / max(form.spread_dn, 1e-12)) ** 2 / form.frames


class TextureEquations:
    """The corrected equations of one patch, as a function of the parameters.

    Parameters
    ----------
    problem, form
        The blurred patch, and the sharp one.
    first
        A fit whose weights and illumination are kept; its parameters may be wrong.
    motion
        Transfer function of the motion.
    """

    def __init__(self, problem: FitProblem, form: TexturedPatch, first: Solution, motion: TransferFunction) -> None:
        self.problem: FitProblem = problem
        self.form: TexturedPatch = form
        self.motion: TransferFunction = motion
        self.light: FloatArray = first.light
        self.root: FloatArray = np.sqrt(first.weight)
        used = first.weight.reshape(len(first.weight), -1).any(axis=1)
        self.template_share: float = template_share(form, first.light[used])
        self.pixels: int = int(np.count_nonzero(first.weight)) - 3 * int(np.count_nonzero(used))
        self.model: DarknessModel = fast_forward_model(problem, motion, exact=True)

    def at(self, p: FloatArray) -> CorrectedEquations:
        """Evaluate at (k + 1,) parameters, the last one the relative contrast."""
        contrast = float(p[-1])
        planes, light = self.problem.planes, self.light
        dark, by_p = self.model(p[:-1])
        columns = illumination_derivatives(planes, light, dark, by_p).astype(np.float64)
        count = len(by_p)
        n = len(columns)
        light_now = light.copy()
        light_now[:, 3] *= contrast
        residual = (planes.values - render_illumination(planes, light_now, dark)) * self.root
        jacobian = np.concatenate(
            (columns[:, :count] * contrast, columns[:, -1:] * light[:, 3, None, None, None]), axis=1
        )
        jacobian *= self.root[:, None]
        residual, jacobian = _without_illumination(
            columns[:, count : count + 3] * self.root[:, None], residual, jacobian
        )
        flat = jacobian.swapaxes(0, 1).reshape(count + 1, -1)
        moments = transfer_moments(self.problem, self.form, self.motion, p[:-1], contrast)
        squares = float(np.vdot(residual, residual))
        widening = 1 + self.template_share * moments.through
        cost = squares / widening
        power = cost / max(self.pixels - count - 1, 1)
        raw = flat @ flat.T
        shape = (n, *planes.values.shape[1:])
        return CorrectedEquations(
            cost,
            widening,
            flat @ residual.ravel() + 0.5 * cost * self.template_share * moments.through_slopes,
            raw - self.pixels * power * self.template_share * moments.bends,
            raw,
            power,
            self.template_share,
            residual.reshape(shape),
            flat.reshape(count + 1, *shape),
            moments,
            self.pixels,
        )

    def score_covariance(self, p: FloatArray, here: CorrectedEquations) -> FloatArray:
        """(m, m) covariance of the score: signal times noise, and noise times noise."""
        image = merge_planes(self.problem.planes, here.jacobian)
        height, width = image.shape[-2:]
        fy, fx = np.broadcast_arrays(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
        own = _moments_at(fx, fy, self.problem.shape_count, self.motion, p[:-1], float(p[-1]))
        power, share = here.noise_power, here.template_share
        white = power * (1 + share * own.power).reshape(fx.shape)
        residual = merge_planes(self.problem.planes, here.residual)
        spectrum = white * _excess_power(residual, white, self.pixels, fx, fy)
        double = np.where((fx > 0) & (fx < 0.5), 2.0, 1.0) / (height * width)
        seen = fft.rfft2(image).reshape(len(image), -1)
        linear = np.real((seen * (spectrum * double).ravel()) @ np.conj(seen.T))
        # The derivatives' own noise is in `seen` too; its product with the residual's noise is counted below.
        scale = self.pixels * power * share
        m = here.moments
        linear -= scale * _products(m.slopes, power * (1 + share * m.power)) / len(m.transfer)
        kappa = (0.5 * share / here.widening * m.through_slopes)[:, None]
        cross = m.slopes / 2 - kappa * m.transfer
        template = -m.power_slopes + kappa * m.power
        second, mixed, first = power**2, share * power**2, share**2 * power**2
        size = len(m.transfer)
        quadratic = second * (kappa @ kappa.T)
        quadratic += mixed * 2 * _products(cross) / size
        quadratic += first * (template @ template.T) / size
        result: FloatArray = linear + 2 * self.pixels * quadratic
        return result


def _without_illumination(
    illumination: FloatArray, residual: FloatArray, jacobian: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residual and derivatives (plane by plane, flat) orthogonal to the illumination's derivatives."""
    n = len(illumination)
    basis = illumination.reshape(n, 3, -1)
    rows = np.concatenate((residual.reshape(n, 1, -1), jacobian.reshape(n, jacobian.shape[1], -1)), axis=1)
    for plane in range(n):
        if basis[plane].any():
            q, _ = np.linalg.qr(basis[plane].T)
            rows[plane] -= (rows[plane] @ q) @ q.T
    return rows[:, 0], rows[:, 1:]


def _excess_power(residual: FloatArray, white: FloatArray, pixels: int, fx: FloatArray, fy: FloatArray) -> FloatArray:
    """Factor, in bands of spatial frequency, by which the residuals' power exceeds that of the noise; 1 at least."""
    power = np.abs(fft.rfft2(residual)) ** 2 / max(pixels, 1)
    band = np.minimum((np.hypot(fx, fy) * 2 * UNCERTAINTY.bands).astype(int), UNCERTAINTY.bands - 1).ravel()
    ratio = np.bincount(band, power.ravel(), UNCERTAINTY.bands) / np.maximum(
        np.bincount(band, white.ravel(), UNCERTAINTY.bands), 1e-300
    )
    count = np.maximum(np.bincount(band, minlength=UNCERTAINTY.bands), 1)
    excess = np.where(ratio > 1 + 3 / np.sqrt(count), np.maximum(ratio, 1.0), 1.0)
    result: FloatArray = excess[band].reshape(fx.shape)
    return result


def safe_inverse(information: FloatArray, raw: FloatArray) -> FloatArray:
    """Inverse of the information with its share of the raw normal matrix kept above a floor."""
    scale = 1 / np.sqrt(np.maximum(np.diag(raw), 1e-300))
    metric = raw * np.outer(scale, scale)
    metric += 1e-9 * np.eye(len(metric))
    shares, vectors = linalg.eigh(information * np.outer(scale, scale), metric)
    inverse = (vectors / np.maximum(shares, TEXTURE.min_share)) @ vectors.T
    result: FloatArray = inverse * np.outer(scale, scale)
    return result
