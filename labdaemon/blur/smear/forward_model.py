"""Equation (1): the modelled image of a target that moves while the shutter is open.

A blurred image Y is the sharp image F, spread along the target's path, plus noise N (McCarthy, Chandler and Palmeri
2016, equation 1):

    Y = H * F + N.

H is the dwell density: the share of the exposure that the target spends at each displacement. In the frequency domain
the convolution is a product, and every factor has a closed form (f in cycles a pixel, ``spectra.closed_form``):

===================  ==========================================================================================
factor               transform
===================  ==========================================================================================
F, a tilted disc     det Q · J1(2πρ)/ρ, ρ = |Q f|; times lens, pixel and template residual (``sharp.target``)
position c           exp(−2πi f·c)
defocus σ²           exp(−2π² σ² |f|²)
H, whole cycles      J0(2π f·a), the transform of the arcsine law; J0(2π √(fᵀMf)) for an orbit, M = aaᵀ + bbᵀ
H, a window          1/T ∫ exp(−2πi f·d(t)) dt, d(t) = a sin ωt + b cos ωt, by quadrature (``waveform``)
H, a light code      the same integral, weighted by the lamp's brightness at t
===================  ==========================================================================================

A point that moves as a·sin ωt over whole cycles dwells at s with the density 1/(π √(a² − s²)), |s| < a: the arcsine
law. Its transform J0 is the whole difference between the blurred and the sharp image.

The image is then that darkness under an illumination: a pixel of colour c is L_c(x)·(1 − k_c·m(x)), with a plane of
light L_c and a contrast k_c (``patch.illumination``). Both are linear; the solver eliminates them.

`forward_model` is this equation and nothing else. The fits use `labdaemon.blur.smear.fast_forward_model`, which has the
same signature and agrees with it to single precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from labdaemon.blur.patch.colour_planes import sample_plane
from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.smear.fit_problem import FitProblem, TransferFunction
from labdaemon.blur.solver.solve import DarknessModel
from labdaemon.blur.spectra import closed_form


def dwell_density(displacement_px: FloatArray, amplitude_px: float) -> FloatArray:
    """Density of the displacement of a sinusoid over whole cycles: the arcsine law 1/(π √(a² − s²)), px⁻¹.

    Parameters
    ----------
    displacement_px
        (n,) s.
    amplitude_px
        a; beyond it the density is 0.
    """
    inside = np.abs(displacement_px) < amplitude_px
    root = np.sqrt(np.where(inside, amplitude_px**2 - displacement_px**2, 1.0))
    return np.where(inside, 1 / (np.pi * root), 0.0)


def forward_model(problem: FitProblem, transfer_function: TransferFunction | None) -> DarknessModel:
    """Darkness H * F of a moving target at each colour plane's pixels, and its derivatives.

    Parameters
    ----------
    problem
        The patch and the target's spectra F.
    transfer_function
        H of the motion, from its own parameters; None for rest.

    Returns
    -------
    DarknessModel
        From the parameters x, y (px), defocus (px²), the k deviations of the shape, then those of the motion.
    """
    grid, planes, rest, k = problem.grid, problem.planes, problem.rest_spectra, problem.shape_count
    fx, fy = grid.fx, grid.fy
    _, height, width = planes.values.shape
    transfer = transfer_function or _rest_transfer

    def sample(spectra: Any) -> FloatArray:
        return sample_plane(spectra, grid, planes.period)[..., :height, :width]

    def model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = p[:2] - np.asarray(planes.origin_px)
        position = np.exp(-2j * np.pi * (fx * x + fy * y))
        defocus = closed_form.gaussian_transfer(fx**2 + fy**2, float(p[2]))
        motion, by_motion = transfer(fx, fy, p[3 + k :])
        blur = motion * defocus * position  # H, with the target's position
        by_nuisance = np.stack((-2j * np.pi * fx, -2j * np.pi * fy, -2 * np.pi**2 * (fx**2 + fy**2))) * blur
        by_own = np.concatenate((by_nuisance, by_motion * defocus * position))
        derivatives = sample(by_own[:, None] * rest.spectra)
        by_shape = sample((rest.by_shape * blur)[:, None] * plane_offsets)
        darkness = sample(rest.spectra * blur) + np.tensordot(p[3 : 3 + k], by_shape, axes=1)
        return darkness, np.concatenate((derivatives[:3], by_shape, derivatives[3:]))

    # The shape's derivatives are those of the mean colour, seen from each plane's first pixel.
    offsets = planes.offset_px[:, :, None, None]
    plane_offsets = np.exp(2j * np.pi * (offsets[:, 0] * fx + offsets[:, 1] * fy))
    return model


def _rest_transfer(fx: FloatArray, fy: FloatArray, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H of rest: 1 everywhere, without a parameter."""
    return np.ones(fx.shape), np.zeros((0, *fx.shape))
