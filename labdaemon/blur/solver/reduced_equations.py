"""Normal equations of a patch with the illumination eliminated (variable projection, doi:10.1137/0710036)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labdaemon.blur.patch.colour_planes import ColourPlanes
from labdaemon.blur.patch.illumination import illumination_derivatives, render_illumination, ridge_matrix
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.least_squares import damped_step, scaled_inverse, unit_scale


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the parameters beforehand: independent of the image."""

    mean: FloatArray
    precision: FloatArray

    def cost(self, p: FloatArray) -> float:
        """Squared distance from the mean in units of the prior's own spread."""
        d = p - self.mean
        return float(d @ self.precision @ d)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the fit ended.

    Attributes
    ----------
    p, covariance
        (k,) and (k, k) of the shape and motion parameters, light eliminated.
    light
        (n, 4) w0, w1, w2, k of each colour plane; x and y run over −1..1 across the patch.
    residual
        (n, h, w) normalised residuals, 0 where masked.
    signal
        (n, h, w) modelled values, DN; where a last step was taken without another look, to first order in it.
    cost
        Sum of squares, prior included.
    dof
        Degrees of freedom.
    converged
        False when the iterations ran out.
    weight
        (n, h, w) inverse variances in use, 0 where masked.
    prior_covariance
        (k, k) what the prior's own uncertainty contributes to the covariance.
    light_jacobian
        (n, 4, k) how each colour plane's light follows the parameters (its negative, that is).
    whitened_jacobian
        (n, k + 4, h·w) derivatives by the parameters and the light, over the pixels' standard deviations.
    correlated_noise
        Whether the covariance already accounts for noise that neighbours share.
    template_noise
        Whether it already accounts for the residuals and for the noise of a textured patch's sharp frame.
    """

    p: FloatArray
    covariance: FloatArray
    light: FloatArray
    residual: FloatArray
    signal: FloatArray
    cost: float
    dof: int
    converged: bool
    weight: FloatArray
    prior_covariance: FloatArray
    light_jacobian: FloatArray
    whitened_jacobian: FloatArray
    correlated_noise: bool = False
    template_noise: bool = False

    @property
    def influence(self) -> FloatArray:
        """(k, n, h, w) change of the parameters by a change of each pixel, DN⁻¹; carries any other error through."""
        k = len(self.p)
        own = self.whitened_jacobian[:, :k] - self.light_jacobian.transpose(0, 2, 1) @ self.whitened_jacobian[:, k:]
        own *= np.sqrt(self.weight).reshape(len(own), 1, -1)
        result: FloatArray = (self.covariance @ own).swapaxes(0, 1).reshape(k, *self.weight.shape)
        return result

    @property
    def chi2(self) -> float:
        """Mean squared normalised residual."""
        return float(np.vdot(self.residual, self.residual)) / max(self.dof, 1)


def weighted_squares(residual: FloatArray, weight: FloatArray) -> float:
    """Weighted sum of squares."""
    return float(np.vdot(residual * weight, residual))


@dataclass(frozen=True, slots=True, eq=False)
class ReducedEquations:
    """Normal equations with each colour plane's light eliminated."""

    reduced: FloatArray
    gradient: FloatArray
    light_elimination: FloatArray
    scale: FloatArray
    whitened_jacobian: FloatArray

    def step(self, damping: float) -> FloatArray:
        """Change of the parameters, with the diagonal raised by a factor 1 + damping."""
        return damped_step(self.reduced, self.gradient, damping)

    def light_step(self, step: FloatArray) -> FloatArray:
        """(n, 4) change of the light that goes with a change of the parameters."""
        k = len(self.gradient)
        result: FloatArray = self.light_elimination[:, :, k] - self.light_elimination[:, :, :k] @ step
        return result


def reduce_normal_equations(
    planes: ColourPlanes,
    residual: FloatArray,
    weight: FloatArray,
    light: FloatArray,
    dark: FloatArray,
    by_p: FloatArray,
    p: FloatArray,
    prior: Prior,
) -> ReducedEquations:
    n, k = len(light), len(p)
    root = np.sqrt(weight)
    columns = illumination_derivatives(planes, light, dark, by_p, residual)
    columns *= root[:, None]
    columns = columns.reshape(n, k + 5, -1)
    with np.errstate(over="ignore", invalid="ignore"):
        products = (columns @ columns.transpose(0, 2, 1)).astype(np.float64)
    if not np.all(np.isfinite(products)):
        products[:] = 0.0  # so far off that single precision overflows: the image says nothing, the prior remains
    normal, products_with_residual = products[:, :-1, :-1], products[:, :-1, -1]
    light_elimination = np.linalg.solve(
        normal[:, k:, k:] + ridge_matrix(normal[:, k:, k:], 1e-12),
        np.concatenate((normal[:, k:, :k], products_with_residual[:, k:, None]), axis=2),
    )
    reduced = (normal[:, :k, :k] - normal[:, :k, k:] @ light_elimination[:, :, :k]).sum(axis=0) + prior.precision
    gradient = (products_with_residual[:, :k] - (normal[:, :k, k:] @ light_elimination[:, :, k:])[..., 0]).sum(axis=0)
    gradient = gradient - prior.precision @ (p - prior.mean)
    scale = unit_scale(reduced)
    return ReducedEquations(reduced, gradient, light_elimination.astype(np.float64), scale, columns[:, :-1])


def linear_update(
    planes: ColourPlanes,
    y: FloatArray,
    weight: FloatArray,
    equations: ReducedEquations,
    prior: Prior,
    p: FloatArray,
    light: FloatArray,
    dark: FloatArray,
    by_p: FloatArray,
    step: FloatArray,
) -> Solution:
    """The solution a last step away, without another look at the model."""
    updated, light = p + step, light + equations.light_step(step)
    signal = render_illumination(planes, light, dark + np.tensordot(step.astype(by_p.dtype), by_p, axes=1))
    cost = weighted_squares(y - signal, weight) + prior.cost(updated)
    return build_solution(weight, equations, prior, updated, light, y - signal, signal, cost, True)


def build_solution(
    weight: FloatArray,
    equations: ReducedEquations,
    prior: Prior,
    p: FloatArray,
    light: FloatArray,
    residual: FloatArray,
    signal: FloatArray,
    cost: float,
    converged: bool,
) -> Solution:
    k = len(p)
    covariance = scaled_inverse(equations.reduced)
    dof = int(np.count_nonzero(weight)) - k - 4 * int(np.count_nonzero(weight.any(axis=(1, 2))))
    prior_covariance = covariance @ prior.precision @ covariance
    light_jacobian = equations.light_elimination[:, :, :k].copy()
    return Solution(
        p,
        covariance,
        light,
        (residual * np.sqrt(weight)).astype(np.float64),
        signal.astype(np.float64),
        cost,
        dof,
        converged,
        weight.astype(np.float64),
        prior_covariance,
        light_jacobian,
        equations.whitened_jacobian,
    )
