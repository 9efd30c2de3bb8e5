"""Textured patches at rest and in motion, over contrast, noise, fineness and number of sharp frames.

The textures are periodic and are moved by their own spectrum, averaged over instants: no formula of the fit is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import click
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from labdaemon.blur import Patch, make_textured_patch, measure_frame, measure_moment
from labdaemon.flags import Flag

FloatArray = NDArray[np.float64]
SIZE_PX = 140  # of the textured square; a patch and its smear lie well inside
BOX = (40, 40, 60, 60)
CONTRASTS, NOISES, FRAMES, LENGTHS_PX = (5.0, 10.0, 20.0, 40.0), (0.5, 1.0, 2.0), (1, 2, 4, 10), (1.0, 2.0, 3.0)


@dataclass(frozen=True, slots=True)
class TextureResult:
    """What a number of patches gave.

    Attributes
    ----------
    amplitude_px
        True semi-amplitude.
    count
        Number of patches.
    false_motions
        Patches at rest with an unflagged motion.
    flagged
        Patches with a flag, or without numbers.
    pull
        RMS of (found − true) / sd: at rest of the signed squared amplitude along x and along y, otherwise of the
        unflagged amplitudes.
    wrong
        Unflagged amplitudes more than four sd from the truth.
    """

    amplitude_px: float
    count: int
    false_motions: int
    flagged: int
    pull: float
    wrong: int


def random_texture(rng: np.random.Generator, size: int, length_px: float) -> FloatArray:
    """(size, size) periodic texture of unit variance, smooth over `length_px`."""
    texture = ndimage.gaussian_filter(rng.normal(size=(size, size)), length_px, mode="wrap")
    result: FloatArray = texture / texture.std()
    return result


def moved(texture: FloatArray, a_px: FloatArray, instants: int = 128) -> FloatArray:
    """The texture averaged over a straight motion of semi-amplitude `a_px` (2,), over whole cycles."""
    place = np.sin(2 * np.pi * (np.arange(instants) + 0.5) / instants)
    fy, fx = (np.fft.fftfreq(n) for n in texture.shape)
    by_x, by_y = (np.exp(-2j * np.pi * np.outer(f, a * place)) for f, a in ((fx, a_px[0]), (fy, a_px[1])))
    result: FloatArray = np.fft.ifft2(np.fft.fft2(texture) * (by_y @ by_x.T) / instants).real
    return result


def run_texture_trials(amplitude_px: float, count: int, seed: int = 1) -> TextureResult:
    """Measure `count` patches of one amplitude in random directions."""
    rng = np.random.default_rng(seed)
    pulls: list[float] = []
    flagged = false_motions = wrong = 0
    for _ in range(count):
        texture = float(rng.choice(CONTRASTS)) * random_texture(rng, SIZE_PX, float(rng.choice(LENGTHS_PX)))
        noise, frames, angle = float(rng.choice(NOISES)), int(rng.choice(FRAMES)), float(rng.uniform(0, np.pi))
        image = moved(texture, amplitude_px * np.array([np.cos(angle), np.sin(angle)])) if amplitude_px else texture
        sharp = [_shoot(rng, texture, noise) for _ in range(frames)]
        blurred = _shoot(rng, image, noise)
        (found,) = measure_frame([make_textured_patch(sharp, BOX)], [blurred])
        flagged += bool(found.flags)
        if amplitude_px == 0:
            false_motions += not found.flags & {Flag.AT_REST, Flag.NOT_FOUND}
            pulls += _pulls_of_squares(sharp, blurred)
        elif not found.flags:
            size = float(np.hypot(*found.a_px))
            along = found.a_px / size
            pulls.append((size - amplitude_px) / float(np.sqrt(along @ found.covariance_px2[2:4, 2:4] @ along)))
            wrong += abs(pulls[-1]) > 4
    pull = float(np.sqrt(np.mean(np.square(pulls)))) if pulls else float("nan")
    return TextureResult(amplitude_px, count, false_motions, flagged, pull, wrong)


def _shoot(rng: np.random.Generator, image: FloatArray, noise: float) -> Patch:
    values = 128 + image + rng.normal(0, noise, image.shape)
    return Patch(values, np.zeros(values.shape, np.uint8), np.ones(values.shape, bool), (0, 0))


def _pulls_of_squares(sharp: list[Patch], blurred: Patch) -> list[float]:
    """Signed squared amplitude along x and y over its sd: rest has no other number without bias."""
    seen = measure_moment(make_textured_patch(sharp, BOX), blurred)
    if seen is None:
        return []
    moment, covariance = seen
    return [float(moment[at] / np.sqrt(covariance[at, at])) for at in (0, 2)]


@click.command("textures")
@click.option("--count", default=100, show_default=True, help="Patches of each amplitude.")
@click.option("--seed", default=1, show_default=True)
def command(count: int, seed: int) -> None:
    """Textured patches: false motion at rest, and whether stated standard deviations are true."""
    click.echo("amplitude px   patches   flagged   false motion   pull   beyond 4 sd")
    for amplitude in (0.0, 1.0, 3.0):
        result = run_texture_trials(amplitude, count, seed)
        click.echo(
            f"{amplitude:12.1f}   {count:7d}   {result.flagged:7d}   {result.false_motions:12d}   {result.pull:4.2f}"
            f"   {result.wrong:11d}"
        )
