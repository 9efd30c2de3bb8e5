"""Nodes of Gauss–Legendre quadrature, computed once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from labdaemon.blur.patch.pixels import FloatArray


@lru_cache(maxsize=512)
def gauss_legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes in −1 … 1 and weights (sum 2) of a number of nodes, each (count,) and not to be written to."""
    nodes, weight = np.polynomial.legendre.leggauss(count)
    nodes.setflags(write=False)
    weight.setflags(write=False)
    return nodes, weight
