"""A renderer by area sampling, in the plain sense: a finely sampled image of a dot is drawn at many instants,
averaged, blurred by a sampled lens kernel, binned into pixels, and given noise. It shares no formula with the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from labdaemon.blur import NoiseModel, Patch

FloatArray = NDArray[np.float64]
Path = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
FINE = 7  # sub-pixels a pixel, not even, so that a pixel's centre is a sub-pixel's


def whole_cycles(ax: float, ay: float, bx: float = 0.0, by: float = 0.0) -> Path:
    """Motion over one cycle, time from 0 to 1."""

    def path(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        s, c = np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)
        return ax * s + bx * c, ay * s + by * c

    return path


def part_cycles(ax: float, ay: float, bx: float, by: float, cycles: float, phase_rad: float) -> Path:
    """Motion from a known phase on, for any number of cycles."""

    def path(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = phase_rad + 2 * np.pi * cycles * t
        s, c = np.sin(angle), np.cos(angle)
        return ax * s + bx * c, ay * s + by * c

    return path


def airy_kernel(width_px: float, reach_px: float = 12.0) -> FloatArray:
    """Sampled Airy pattern, (2 J1(πr/w)/(πr/w))², w = λN in pixels."""
    from scipy.special import j1

    half = int(reach_px * FINE)
    y, x = np.mgrid[-half : half + 1, -half : half + 1] / FINE
    v = np.pi * np.hypot(x, y) / width_px
    pattern = np.where(v > 1e-9, (2 * j1(np.maximum(v, 1e-9)) / np.maximum(v, 1e-9)) ** 2, 1.0)
    return pattern / pattern.sum()


@dataclass(frozen=True)
class Scene:
    """One dot on paper."""

    radius_px: float = 15.7
    minor_ratio: float = 1.0
    angle_rad: float = 0.0
    sigma_px: float | tuple[float, ...] = 0.8
    airy_px: tuple[float, ...] | None = None
    white_dn: tuple[float, ...] = (2500.0,)
    ink: float = 0.08
    gradient: tuple[float, float] = (0.0, 0.0)
    electrons_per_dn: float = 8.5
    read_electrons: float = 7.0
    bayer: bool = False
    offset_px: tuple[tuple[float, float], ...] | None = None
    texture: float = 0.0
    texture_px: float = 1.5
    texture_seed: int = 7

    @property
    def noise(self) -> NoiseModel:
        return NoiseModel(self.read_electrons / self.electrons_per_dn, 1 / self.electrons_per_dn)


def _fine_dot(scene: Scene, shape: tuple[int, int], cx: FloatArray, cy: FloatArray) -> FloatArray:
    """Mean over instants of the dot's coverage of sub-pixels, hard-edged within a sub-pixel's width."""
    h, w = shape
    y = (np.arange(h * FINE) - (FINE - 1) / 2) / FINE
    x = (np.arange(w * FINE) - (FINE - 1) / 2) / FINE
    c, s = np.cos(scene.angle_rad), np.sin(scene.angle_rad)
    total = np.zeros((h * FINE, w * FINE))
    for mx, my in zip(cx, cy, strict=True):
        dx, dy = x[None, :] - mx, y[:, None] - my
        u, v = c * dx + s * dy, (-s * dx + c * dy) / scene.minor_ratio
        r = np.sqrt(u * u + v * v)
        scale = np.sqrt(u * u + (v / scene.minor_ratio) ** 2) / np.maximum(r, 1e-9)  # |grad r|
        total += np.clip((scene.radius_px - r) / np.maximum(scale, 1e-9) * FINE + 0.5, 0, 1)
    return total / len(cx)


def render(
    scene: Scene,
    shape: tuple[int, int],
    centre: tuple[float, float],
    path: Path | None = None,
    *,
    seed: int | None = 0,
    samples: int = 240,
    extra_sigma_px: float = 0.0,
    origin: tuple[int, int] = (0, 0),
    saturation_dn: float = 4095.0,
    exposure: float = 1.0,
    hidden: tuple[int, int, int, int] | None = None,
) -> Patch:
    """Photograph the dot. `seed=None` leaves the noise away; `hidden` is a box of opaque grey in front."""
    h, w = shape
    t = (np.arange(samples) + 0.5) / samples
    dx, dy = path(t) if path is not None else (np.zeros(1), np.zeros(1))
    dot = _fine_dot(scene, shape, centre[0] - origin[0] + dx, centre[1] - origin[1] + dy)
    reflect = 1 - (1 - scene.ink) * dot
    if scene.texture > 0:
        rng = np.random.default_rng(scene.texture_seed)
        pad = int(4 * scene.texture_px) + 64
        texture = ndimage.gaussian_filter(rng.normal(size=(h + 2 * pad, w + 2 * pad)), scene.texture_px)
        texture *= scene.texture * 2 * np.sqrt(np.pi) * scene.texture_px
        moved = np.zeros((h, w))
        for mx, my in zip(dx, dy, strict=True):
            moved += ndimage.shift(texture, (my, mx), order=1, mode="nearest")[pad : pad + h, pad : pad + w]
        moved /= len(dx)
        reflect = reflect * (1 + np.kron(moved, np.ones((FINE, FINE))))
    y, x = np.mgrid[0:h, 0:w].astype(float)
    light = 1 + scene.gradient[0] * (x - w / 2) + scene.gradient[1] * (y - h / 2)
    channel = np.zeros(shape, dtype=np.uint8)
    if scene.bayer:
        channel[0::2, 1::2], channel[1::2, 0::2], channel[1::2, 1::2] = 1, 3, 2
    image = np.zeros(shape)
    for c in range(4 if scene.bayer else 1):
        sigma = scene.sigma_px[c] if isinstance(scene.sigma_px, tuple) else scene.sigma_px
        view = reflect
        if scene.offset_px is not None:
            oy, ox = scene.offset_px[c][1] * FINE, scene.offset_px[c][0] * FINE
            view = ndimage.shift(view, (oy, ox), order=1, mode="nearest")
        if scene.airy_px is not None:
            kernel = airy_kernel(scene.airy_px[c])
            half = kernel.shape[0] // 2
            view = signal.fftconvolve(np.pad(view, half, mode="edge"), kernel, mode="valid")
        total = np.hypot(sigma, extra_sigma_px)
        if total > 0:
            view = ndimage.gaussian_filter(view, total * FINE, mode="nearest", truncate=6)
        binned = view.reshape(h, FINE, w, FINE).mean(axis=(1, 3))
        plane = binned * light * scene.white_dn[c % len(scene.white_dn)] * exposure
        image = np.where(channel == c, plane, image)
    if seed is not None:
        rng = np.random.default_rng(seed)
        electrons = rng.poisson(np.maximum(image, 0) * scene.electrons_per_dn)
        image = (electrons + rng.normal(0, scene.read_electrons, shape)) / scene.electrons_per_dn
        image = np.round(image)
    if hidden is not None:
        left, top, wide, high = hidden
        image[top - origin[1] : top - origin[1] + high, left - origin[0] : left - origin[0] + wide] = 0.4 * image.max()
    return Patch(np.minimum(image, saturation_dn), channel, image < saturation_dn, origin)
