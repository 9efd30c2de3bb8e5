"""The last step of a fit: generalised least squares with the paper texture as correlated noise.

Photon and read noise differ from pixel to pixel; paper texture does not, and moving paper smears it along the path. A
fit that takes all noise for independent is unbiased, but it loses up to half of the information of a long smear and
understates its covariance. Here

- what the sharp frame shows of the paper texture (`texture_map`) is subtracted, once blurred with the target and once
  static, each with a fitted amplitude: labels move with their dots, a wall behind a dot does not, and neither does
  the sensor's own pattern;
- the rest is weighed by W^½ F W^½, with W the inverse variance of the independent noise and F a filter 1/(1 + κS), S
  the spectrum of the paper texture that is left and κ the mean ratio of the two;
- light may bend: the diffracted skirts of the paper's own edges, and lamps, add a quadratic surface to the plane;
- the covariance is the inverse normal matrix: that of the true noise under this weight is 0 to 5 % smaller.

The illumination of each colour plane is eliminated first, under W: what remains does not depend on it under any weight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft

from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes, split_planes
from labdaemon.blur.patch.illumination import (
    illumination_coordinates,
    illumination_derivatives,
    paper_level,
    ridge_matrix,
)
from labdaemon.blur.patch.pixels import BoolArray, ComplexArray, FloatArray, NoiseModel
from labdaemon.blur.settings import GLS
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.sharp.texture_map import half_plane_frequencies, texture_power, unmapped_power
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.reduced_equations import Prior, Solution
from labdaemon.blur.solver.solve import DarknessModel
from labdaemon.blur.spectra import closed_form
from labdaemon.blur.spectra.render import to_single
from labdaemon.least_squares import scaled_inverse


def gls_refine(
    sharp: SharpTarget,
    problem: FitProblem,
    solution: Solution,
    model: DarknessModel,
    moment_px2: FloatArray,
    prior: Prior,
) -> Solution:
    """One Gauss–Newton step from a solution with paper texture in the weights, and the covariance that goes with it.

    Parameters
    ----------
    sharp, problem
        The target and what was fitted.
    solution
        A converged fit with independent weights.
    model, prior
        As it was fitted with.
    moment_px2
        (3,) the motion's aaᵀ + bbᵀ, as m0, m1, m2.

    Returns
    -------
    Solution
        As given where the noise is not known, or the residuals are not noise.
    """
    if not sharp.noise_known or solution.chi2 > GLS.max_chi2:
        return solution
    dark, by_p = model(solution.p)

    def blur(fx: FloatArray, fy: FloatArray) -> FloatArray:
        return closed_form.blurred_orbit_transfer(fx, fy, float(solution.p[2]), moment_px2)

    motion = TextureMotion(blur, np.sqrt(np.maximum(moment_px2[[0, 2]], 0.0)), solution.p[:2])
    part = FramePart(
        problem.planes, problem.shape_count, solution.light, solution.signal, solution.weight > 0, dark, by_p
    )
    normal, _ = frame_equations(sharp, part, motion)
    return refined_solution(solution, normal[:-1, :-1], normal[:-1, -1], prior)


def refined_solution(solution: Solution, normal: FloatArray, pull: FloatArray, prior: Prior) -> Solution:
    """The step of filtered normal equations, and their inverse as covariance."""
    covariance = scaled_inverse(normal + prior.precision)
    step = covariance @ (pull - prior.precision @ (solution.p - prior.mean))
    light = solution.light - solution.light_jacobian @ step
    return replace(solution, p=solution.p + step, light=light, covariance=covariance, correlated_noise=True)


@dataclass(frozen=True, slots=True, eq=False)
class FramePart:
    """One frame's part of a fit.

    Attributes
    ----------
    planes, shape_count
        Its pixels, and the number of shape parameters.
    light, signal, valid
        (n, 4), (n, h, w) and (n, h, w) its rows of the solution, and where that has weight.
    dark, by_p
        (n, h, w) and (k, n, h, w) the model and its derivatives by x, y, extra blur, the shape and the motion.
    extra_count
        How many more of those follow, by what is no parameter of the fit.
    """

    planes: ColourPlanes
    shape_count: int
    light: FloatArray
    signal: FloatArray
    valid: BoolArray
    dark: FloatArray
    by_p: FloatArray
    extra_count: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class FrameWeights:
    """Weights of one frame: W and F of the module's docstring.

    Attributes
    ----------
    weight
        (n, h, w) inverse variances of the independent noise.
    keep
        Half spectrum of the filter.
    """

    weight: FloatArray
    keep: FloatArray


def frame_equations(
    sharp: SharpTarget, part: FramePart, motion: TextureMotion, weights: FrameWeights | None = None
) -> tuple[FloatArray, FrameWeights]:
    """Filtered products of a frame's derivatives and residuals, and the weights used.

    The frame's illumination, its curvature and the amplitudes of the mapped texture are eliminated.

    Parameters
    ----------
    weights
        To be used instead of those that the motion makes, so that sums of squares can be compared.

    Returns
    -------
    products, weights
        (k + 1, k + 1), residuals last: the last element is their weighted sum of squares.
    """
    noise, planes, k = sharp.noise, part.planes, len(part.by_p)
    own = np.where(part.valid, 1 / np.maximum(noise.variance(part.signal), 1e-12), 0.0)
    weight = own if weights is None else weights.weight
    level = merge_planes(planes, paper_level(planes, part.light))
    columns = illumination_derivatives(planes, part.light, part.dark, part.by_p)
    root = merge_planes(planes, np.sqrt(weight))
    signal = merge_planes(planes, part.signal)
    texture_noise = _TextureNoise.predict(sharp, planes, motion, signal, level)
    left = planes.values - part.signal
    extra = [part.signal * bend for bend in _curvature_terms(planes)] + [
        split_planes(planes, one) for one in texture_noise.predictions
    ]
    wanted = np.concatenate((columns[:, :k].swapaxes(0, 1), to_single(np.stack((*extra, left)))))
    free = merge_planes(planes, _project_out_illumination(wanted, columns[:, k:], to_single(weight)))
    size = tuple(int(fft.next_fast_len(length + GLS.margin_px, real=True)) for length in root.shape)
    if weights is None:
        amplitudes = texture_noise.texture_amplitudes(free[k + 3 : -1], free[-1], root)
        unmapped = _unmapped_fraction(sharp, planes, free[3 + part.shape_count : k - part.extra_count], root)
        paper = root > 0
        ratio = float(np.mean((root * signal)[paper] ** 2)) if paper.any() else 0.0
        keep = 1 / (1 + ratio * texture_noise.residual_spectrum(amplitudes, unmapped, size))
        weights = FrameWeights(weight, keep)
    waves = fft.rfft2(free * to_single(root), s=size)
    normal = _filtered_products(waves, waves, weights.keep, size)
    expected = [(0.0, GLS.curvature_sd)] * 3 + [GLS.moving_prior, GLS.static_prior][: len(texture_noise.predictions)]
    mean, sd = np.array(expected).T
    extras = slice(k, k + len(expected))
    normal[extras, extras] += np.diag(sd**-2)
    normal[extras, -1] += mean * sd**-2
    normal[-1, extras] += mean * sd**-2
    normal[-1, -1] += float(np.sum((mean / sd) ** 2))
    kept = [*range(k), -1]
    eliminated = scaled_inverse(normal[extras, extras]) @ normal[extras][:, kept]
    result: FloatArray = normal[np.ix_(kept, kept)] - normal[kept][:, extras] @ eliminated
    return result, weights


@dataclass(frozen=True, slots=True, eq=False)
class TextureMotion:
    """How the motion and the extra blur smear the paper texture of one frame.

    Attributes
    ----------
    transfer
        From fx (1, w) and fy (h, 1) to the transfer function.
    reach_px
        (2,) how far a point moves in x and y.
    place_px
        (2,) the place about which the target moves, frame coordinates.
    """

    transfer: Callable[[FloatArray, FloatArray], FloatArray | ComplexArray]
    reach_px: FloatArray
    place_px: FloatArray

    @classmethod
    def through_window(cls, transfer: TransferFunction, place: FloatArray, motion: FloatArray) -> TextureMotion:
        """Of a motion seen through a window.

        Parameters
        ----------
        transfer
            The motion's transfer function.
        place
            (3,) x, y, extra blur.
        motion
            Its parameters.
        """

        def blur(fx: FloatArray, fy: FloatArray) -> ComplexArray:
            defocus = closed_form.gaussian_transfer(fx * fx + fy * fy, float(place[2]))
            wide_x, wide_y = np.broadcast_arrays(fx, fy)
            return np.asarray(transfer(wide_x, wide_y, motion)[0] * defocus, dtype=np.complex128)

        return cls(blur, np.full(2, float(np.linalg.norm(motion))), place[:2])


@dataclass(frozen=True, slots=True, eq=False)
class _TextureNoise:
    """What is known of the paper texture in one blurred patch.

    Attributes
    ----------
    predictions
        What the sharp frame's map predicts (darker: negative), DN: moved and blurred with the target, and static.
        Empty without a map.
    noise
        With the paper texture's strength and length.
    map_noise
        Noise of the map; infinite without one.
    motion
        What smears the texture that moves.
    """

    predictions: list[FloatArray]
    noise: NoiseModel
    map_noise: float
    motion: TextureMotion

    @classmethod
    def predict(
        cls,
        sharp: SharpTarget,
        planes: ColourPlanes,
        motion: TextureMotion,
        signal: FloatArray,
        level: FloatArray,
    ) -> _TextureNoise:
        paper = sharp.texture_map
        if paper is None:
            return cls([], sharp.noise, np.inf, motion)
        origin = np.asarray(planes.origin_px)
        height, width = signal.shape
        moved = paper.blur(motion.transfer, motion.reach_px, motion.place_px - origin, (height, width))
        still = paper.shift(sharp.centre_px - origin, (height, width))
        return cls([-level * moved, -signal * still], sharp.noise, paper.noise, motion)

    def texture_amplitudes(self, predictions: FloatArray, left: FloatArray, root: FloatArray) -> tuple[float, float]:
        """Amplitudes of the texture that moves with the target and of the static one: least squares on the residuals.

        Parameters
        ----------
        predictions, left
            (2, h, w) predictions and (h, w) residuals, light eliminated.
        root
            (h, w) inverse standard deviations.
        """
        if not self.predictions:
            return 1.0, 0.0
        flat = (predictions * root).reshape(2, -1)
        mean, sd = np.array([GLS.moving_prior, GLS.static_prior]).T
        normal = flat @ flat.T + np.diag(sd**-2)
        found = np.linalg.solve(normal, flat @ (left * root).ravel() + mean * sd**-2)
        moving, still = np.clip(found, 0.0, GLS.max_texture_amplitude)
        return float(moving), float(still)

    def residual_spectrum(
        self, texture_amplitudes: tuple[float, float], unmapped: float, size: tuple[int, ...]
    ) -> FloatArray:
        """Spectrum of the unmapped paper texture, relative to the paper's brightness squared.

        Parameters
        ----------
        texture_amplitudes
            How much of the paper texture moves, and how much stands.
        unmapped
            Part of what the motion shows by that is seen against paper which the dot at rest covered.
        size
            Of the images (h, w).
        """
        fx, fy = half_plane_frequencies(size)
        power = texture_power(self.noise, fx**2 + fy**2)
        left = unmapped_power(power, self.map_noise, fx, fy)
        smear = np.abs(self.motion.transfer(fx, fy))
        static_power = left + unmapped * (power - left)
        result: FloatArray = texture_amplitudes[0] ** 2 * left * smear**2 + texture_amplitudes[1] ** 2 * static_power
        return result


def _unmapped_fraction(sharp: SharpTarget, planes: ColourPlanes, by_motion: FloatArray, root: FloatArray) -> float:
    """Part of the motion's information that lies where the dot was at rest, over paper that no map shows.

    Parameters
    ----------
    by_motion
        (m, h, w) derivatives by the motion's parameters.
    root
        (h, w) inverse standard deviations.
    """
    x, y = sharp.centre_px - np.asarray(planes.origin_px)
    height, width = root.shape
    covered = np.hypot(np.arange(width) - x, np.arange(height)[:, None] - y) < max(sharp.form.half_size_px)
    information = np.sum((by_motion * root) ** 2, axis=0)
    return float(np.sum(information[covered]) / max(float(np.sum(information)), 1e-300))


def _curvature_terms(planes: ColourPlanes) -> list[FloatArray]:
    """Quadratic surfaces over the patch."""
    u, v = illumination_coordinates(planes)
    return [u * u - 1 / 3, u * v, v * v - 1 / 3]


def _project_out_illumination(predictions: FloatArray, light: FloatArray, weight: FloatArray) -> FloatArray:
    """(m, n, h, w) images less what each colour plane's light explains of them.

    Parameters
    ----------
    light
        (n, 4, h, w) derivatives by the light.
    weight
        (n, h, w) inverse variances.
    """
    n = len(light)
    own, w = light.reshape(n, 4, -1), weight.reshape(n, 1, -1)
    flat = predictions.swapaxes(0, 1).reshape(n, len(predictions), -1)
    scaled = own * w
    normal = (scaled @ own.transpose(0, 2, 1)).astype(np.float64)
    part = np.linalg.solve(normal + ridge_matrix(normal, 1e-12), scaled @ flat.transpose(0, 2, 1)).astype(flat.dtype)
    result: FloatArray = (flat - part.transpose(0, 2, 1) @ own).reshape(n, len(predictions), *weight.shape[1:])
    return result.swapaxes(0, 1)


def _filtered_products(first: Any, second: Any, residual_spectrum: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """(i, j) sums over all pixels of filtered images times others, from their half spectra (Parseval)."""
    twice = np.full(residual_spectrum.shape[1], 2.0)
    twice[0] = 1.0
    if size[1] % 2 == 0:
        twice[-1] = 1.0
    factor = residual_spectrum * twice / (size[0] * size[1])
    left = (first * factor).reshape(len(first), -1).view(np.float64)
    right = second.astype(np.complex128).reshape(len(second), -1).view(np.float64)
    result: FloatArray = left @ right.T
    return result
