"""Bessel functions J0 and J1: from a table where single precision is wanted, which is several times as fast."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import special

from labdaemon.blur.patch.pixels import FloatArray
from labdaemon.blur.settings import CACHE


@lru_cache(maxsize=1)
def _table() -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """J0, J1 and the slope of J1."""
    z = np.arange(int(CACHE.bessel_max * CACHE.bessel_steps) + 2) / CACHE.bessel_steps
    j0, j1 = special.j0(z), special.j1(z)
    slope = j0 - np.divide(j1, z, out=np.full(len(z), 0.5), where=z > 0)
    return j0.astype(np.float32), j1.astype(np.float32), slope.astype(np.float32)


def j0_j1(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J0 and J1 of non-negative arguments, in their precision."""
    if z.dtype != np.float32 or z.size == 0 or not float(z.max()) <= CACHE.bessel_max:
        return special.j0(z), special.j1(z)
    table0, table1, slope1 = _table()
    scaled = z * np.float32(CACHE.bessel_steps)
    place = (scaled + np.float32(0.5)).astype(np.intp)
    beyond = (scaled - place.astype(np.float32)) * np.float32(1 / CACHE.bessel_steps)
    at1 = table1[place]
    return table0[place] - beyond * at1, at1 + beyond * slope1[place]
