"""How a sinusoidal path in space appears in an image: mean and first harmonic of its projection.

A camera is not linear, so the ends of a long path are not at equal distances from the image of its mean. What the
blur measurement reports is the path's mean and first harmonic, which are computed here by quadrature over one cycle
(the plain mean over equally spaced phases is exact for the harmonics that matter).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from labdaemon.geometry.motion import FloatArray

NODES = 12
_PHASE = 2.0 * np.pi * (np.arange(NODES) + 0.5) / NODES
_SIN, _COS = np.sin(_PHASE), np.cos(_PHASE)
_BASIS = np.stack([np.ones(NODES), _SIN, _COS])  # how mean, a and b enter the path
_WEIGHT = np.stack([np.ones(NODES), 2.0 * _SIN, 2.0 * _COS]) / NODES  # and are taken from it again

Projector = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""(n, d) points -> (n, 2) pixels, (n, 2, d) derivative by the points, (n, 2, m) by its other parameters."""


def project_motion(project: Projector, motion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and first harmonic of a path's image.

    Parameters
    ----------
    project
        Maps points to pixels, with derivatives (`OrientedCamera.project_with_jacobians` is one).
    motion
        (3, d): mean, a and b of ``d(t) = a sin(ωt) + b cos(ωt)`` about the mean, mm.

    Returns
    -------
    tuple
        (6,) image (x, y, ax, ay, bx, by) in px; (6, 3 d) its derivative by (mean, a, b); (6, m) its derivative by
        the projector's other parameters.
    """
    dimension = motion.shape[1]
    pixels, by_point, by_other = project(_BASIS.T @ motion)
    image = (_WEIGHT @ pixels).reshape(6)
    by_motion = np.einsum("hn,nij,kn->hikj", _WEIGHT, by_point, _BASIS).reshape(6, 3 * dimension)
    by_parameter = np.einsum("hn,nij->hij", _WEIGHT, by_other).reshape(6, -1)
    return image, by_motion, by_parameter
