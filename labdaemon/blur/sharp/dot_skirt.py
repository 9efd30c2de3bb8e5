"""The light that a dot takes from the paper around it: diffraction darkens it many pixels away.

At f/32 the paper is 2 % darker 4 px beyond the edge of a dot of 16 px radius, and 0.3 % at 10 px. Skirts that count as
paper texture more than double its power at low frequencies, which is what limits long paths.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labdaemon.blur.patch.colour_planes import make_grid, make_planes, merge_planes
from labdaemon.blur.patch.pixels import Patch
from labdaemon.blur.settings import SHARP_FIT, TEXTURE_MAP
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.spectra.render import render_darkness, shift_spectra, to_single


def without_skirts(patch: Patch, dot: SharpTarget) -> Patch:
    """The sharp patch as if its dot took no light from the paper; on the dot itself it has no meaning.

    Parameters
    ----------
    patch
        As much of the sharp frame around the dot as there is.
    dot
        As it was fitted.
    """
    reach = int(max(dot.form.half_size_px) + TEXTURE_MAP.skirt_px)
    left, top = (int(np.rint(v)) - reach for v in dot.centre_px)
    part = patch.crop(left, top, 2 * reach + 1, 2 * reach + 1)
    height, width = part.shape
    if min(height, width) < 2:
        return patch
    planes = make_planes(part)
    size = (height + SHARP_FIT.margin_px, width + SHARP_FIT.margin_px)
    grid = make_grid(size, oversampling=dot.form.oversampling)
    spectra, _ = dot.form.spectra(grid, planes.channel)
    dark = render_darkness(to_single(shift_spectra(spectra, grid, planes, dot.centre_px)), grid, planes)
    contrast = np.array([dot.contrast.get(int(channel), 0.0) for channel in planes.channel])
    taken = merge_planes(planes, contrast[:, None, None] * dark)[:height, :width]
    x0, y0 = part.origin_px[0] - patch.origin_px[0], part.origin_px[1] - patch.origin_px[1]
    values = patch.values.copy()
    values[y0 : y0 + height, x0 : x0 + width] /= 1 - np.clip(taken, 0.0, TEXTURE_MAP.max_skirt)
    return replace(patch, values=values)
