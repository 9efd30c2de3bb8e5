"""The paper texture, as the sharp frame shows it: it is on the paper, so it moves with the target.

Paper texture is what limits long smears: photons average out along the path, but paper texture is dragged along and
stays. What the sharp frame shows of it does not count as noise. Each spatial frequency is kept in the proportion
in which it stands above the sharp frame's own noise (Wiener); the rest stays noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from labdaemon.blur.patch.colour_planes import ColourPlanes, merge_planes
from labdaemon.blur.patch.illumination import paper_level
from labdaemon.blur.patch.paper_texture import estimate_texture
from labdaemon.blur.patch.pixels import BoolArray, ComplexArray, FloatArray, NoiseModel, Patch
from labdaemon.blur.settings import TEXTURE_MAP
from labdaemon.blur.solver.reduced_equations import Solution


@dataclass(frozen=True, slots=True, eq=False)
class PaperTextureMap:
    """Paper texture around a target.

    Attributes
    ----------
    dark
        (h, w) expected darkness beyond the model's, relative to the paper's brightness; 0 where nothing is known.
    centre_px
        (2,) the target's centre in this array, x and y.
    noise
        Variance of the sharp frame's own noise in it, relative to the paper's brightness squared.
    """

    dark: NDArray[np.float16]
    centre_px: FloatArray
    noise: float

    def blur(
        self,
        transfer: Callable[[FloatArray, FloatArray], FloatArray | ComplexArray],
        reach_px: FloatArray,
        centre_px: FloatArray,
        shape: tuple[int, int],
    ) -> FloatArray:
        """(h, w) the paper texture in a patch, smeared with the target.

        Parameters
        ----------
        transfer
            Transfer function of motion and extra blur, from fx (1, w) and fy (h, 1).
        reach_px
            (2,) how far the motion reaches in x and y.
        centre_px
            (2,) the place about which the target moves, in the patch.
        shape
            Of the patch.
        """
        height, width = shape
        move = centre_px - self.centre_px
        whole = np.rint(move).astype(int)
        # A path that has run away is cut at the patch's own size: its light is no evidence either way.
        reach = np.minimum(np.ceil(reach_px), max(shape))
        pad_x, pad_y = (int(v) + 2 for v in reach)
        # Everything that can have come into the patch.
        around = (height + 2 * pad_y, width + 2 * pad_x)
        part = self._crop_map(-pad_x - whole[0], -pad_y - whole[1], around)
        size = (int(fft.next_fast_len(around[0], real=True)), int(fft.next_fast_len(around[1], real=True)))
        fx, fy = half_plane_frequencies(size)
        rest = move - whole
        turn = np.exp(-2j * np.pi * rest[1] * fy) * np.exp(-2j * np.pi * rest[0] * fx)
        factor = transfer(fx, fy) * turn
        image = fft.irfft2(fft.rfft2(part, s=size) * factor.astype(np.complex64), s=size)
        result: FloatArray = image[pad_y : pad_y + height, pad_x : pad_x + width].astype(np.float64)
        return result

    def shift(self, centre_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """(h, w) the paper texture with the resting target at `centre_px` (2,) of the patch, to the nearest pixel."""
        left, top = np.rint(centre_px - self.centre_px).astype(int)
        return self._crop_map(-left, -top, shape).astype(np.float64)

    def _crop_map(self, left: int, top: int, shape: tuple[int, int]) -> NDArray[np.float32]:
        """(h, w) a rectangle of the map, 0 beyond it."""
        part = np.zeros(shape, dtype=np.float32)
        height, width = self.dark.shape
        ax, ay, bx, by = max(left, 0), max(top, 0), min(left + shape[1], width), min(top + shape[0], height)
        if bx > ax and by > ay:
            part[ay - top : by - top, ax - left : bx - left] = self.dark[ay:by, ax:bx]
        return part


def texture_power(noise: NoiseModel, f2: FloatArray) -> FloatArray:
    """Power of the paper texture at squared frequencies, relative to the paper's brightness squared, px²."""
    length = noise.texture_px
    result: FloatArray = noise.texture**2 * 4 * np.pi * length**2 * np.exp(-4 * np.pi**2 * length**2 * f2)
    return result


def unmapped_power(power: FloatArray, map_noise: float, fx: FloatArray, fy: FloatArray) -> FloatArray:
    """Power of the paper texture that the map does not predict, from its `power`; as `texture_power`.

    The map is H K (g + n): g the paper texture, n the sharp frame's noise of power `map_noise` (infinite: no map), K
    the Wiener filter, H the high-pass of the background (`TextureMapSettings`). What remains is |1 − HK|²
    of the paper texture and |HK|² of the noise.
    """
    if not np.isfinite(map_noise):
        return power
    kept = (
        power
        / (power + map_noise)
        * (1 - np.sinc(TEXTURE_MAP.background_size_px * fx) * np.sinc(TEXTURE_MAP.background_size_px * fy))
    )
    result: FloatArray = power * (1 - kept) ** 2 + map_noise * kept**2
    return result


@lru_cache(maxsize=64)
def half_plane_frequencies(size: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Frequencies (1, w // 2 + 1) and (h, 1) of images of `size` (h, w), cycles a pixel."""
    fx, fy = np.fft.rfftfreq(size[1]), np.fft.fftfreq(size[0])
    return fx[None, :].astype(np.float64), fy[:, None].astype(np.float64)


def map_paper_texture(
    patch: Patch,
    planes: ColourPlanes,
    solution: Solution,
    centre_px: FloatArray,
    radius_px: float,
    paper_px: float,
    noise: NoiseModel,
) -> tuple[PaperTextureMap | None, NoiseModel]:
    """Paper texture around a fitted dot, and the noise model with the strength of it that all this paper shows.

    Parameters
    ----------
    patch
        As much of the sharp frame around the dot as there is.
    planes, solution
        The fit of the dot and what is near it.
    centre_px, radius_px
        The dot's, frame coordinates.
    paper_px
        Distance of the paper's edge.
    noise
        Of this image (a mean of frames has less than one), by the fit of the dot.

    Returns
    -------
    map, noise
        No map, and the noise as given, where little paper is to be seen or it is not plain paper.
    """
    reach = int(min(paper_px - TEXTURE_MAP.edge_margin_px, radius_px + TEXTURE_MAP.max_radius_px))
    left, top = (int(np.rint(v)) - reach for v in centre_px)
    wide = patch.crop(left, top, 2 * reach + 1, 2 * reach + 1)
    height, width = wide.shape
    x = np.arange(width) + wide.origin_px[0] - centre_px[0]
    y = (np.arange(height) + wide.origin_px[1] - centre_px[1])[:, None]
    distance = np.hypot(x, y)
    paper = wide.valid & (distance < reach) & (distance > radius_px + TEXTURE_MAP.dot_margin_px)
    if not paper.any():
        return None, noise
    dark, white = np.zeros(wide.shape), np.zeros(wide.shape)
    for channel in np.unique(wide.channel):
        here = paper & (wide.channel == channel)
        if np.count_nonzero(here) < TEXTURE_MAP.min_pixels:
            return None, noise
        level = _fit_surface(wide.values, here, x / reach, y / reach)
        dark[here] = 1 - wide.values[here] / level[here]
        white[here] = noise.variance(level[here]) / level[here] ** 2
    # Hot pixels and specks of dirt.
    paper &= np.abs(dark) < 5 * 1.48 * float(np.median(np.abs(dark[paper])))
    dark[~paper] = 0.0
    near = ndimage.uniform_filter(paper.astype(np.float64), TEXTURE_MAP.background_size_px, mode="constant")
    dark -= np.where(
        paper,
        ndimage.uniform_filter(dark, TEXTURE_MAP.background_size_px, mode="constant") / np.maximum(near, 1e-3),
        0.0,
    )
    floor = float(np.mean(white[paper]))
    if float(np.mean(dark[paper] ** 2)) > TEXTURE_MAP.max_variance_ratio * (floor + noise.texture**2):
        return None, noise
    texture, length = estimate_texture(dark, paper.astype(np.float64), paper.astype(np.float64))
    noise = replace(noise, texture=texture, texture_px=length)
    if texture <= 0:
        return None, noise
    _insert_dot_residual(dark, wide, planes, solution)
    fx, fy = half_plane_frequencies((height, width))
    power = texture_power(noise, fx**2 + fy**2)
    kept = fft.irfft2(fft.rfft2(dark) * (power / (power + floor)), s=dark.shape)
    return PaperTextureMap(kept.astype(np.float16), centre_px - np.asarray(wide.origin_px), floor), noise


def _fit_surface(values: FloatArray, paper: BoolArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """(h, w) brightness of bare paper: a quadratic surface through its pixels."""
    full_x, full_y = np.broadcast_arrays(x, y)

    def design(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.stack((np.ones_like(u), u, v, u * u, u * v, v * v), axis=-1)

    rows = design(full_x[paper], full_y[paper])
    coefficients = np.linalg.solve(rows.T @ rows, rows.T @ values[paper])
    result: FloatArray = design(full_x, full_y) @ coefficients
    return result


def _insert_dot_residual(dark: FloatArray, wide: Patch, planes: ColourPlanes, solution: Solution) -> None:
    """Where the dot was fitted, what that fit left over is the better account, the dot itself included."""
    level = paper_level(planes, solution.light)
    left = np.where(solution.weight > 0, (solution.signal - planes.values) / np.maximum(level, 1e-9), 0.0)
    near = merge_planes(planes, left)
    x0, y0 = planes.origin_px[0] - wide.origin_px[0], planes.origin_px[1] - wide.origin_px[1]
    ax, ay = max(x0, 0), max(y0, 0)
    bx, by = min(x0 + near.shape[1], dark.shape[1]), min(y0 + near.shape[0], dark.shape[0])
    if bx > ax and by > ay:
        dark[ay:by, ax:bx] = near[ay - y0 : by - y0, ax - x0 : bx - x0]
