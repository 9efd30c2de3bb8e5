"""Single dots on textured paper, sharp and moving, as small images: for benches of many trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labdaemon.bench.simulator import Renderer, renderer
from labdaemon.blur import Dot, FloatArray, NoiseModel, Patch, SharpTarget, fit_sharp

PX_PER_MM = 24.0 / 6.1
RADIUS_MM = 4.0
TEXTURE_MM = 0.3
"""Length over which the simulator's paper texture is correlated, exp(−r²/(2·length²)): √2 of `NoiseModel`'s."""
MARGIN_PX = 16
DIFFRACTION_PX = 2.8
"""Wavelength times f-number at f/32, mean of the mosaic's colours."""
OWN_LENS_SIGMA_PX = 0.13
"""What the simulated lens adds to the blur of diffraction."""
PLAIN_NOISE = NoiseModel(read_dn=7.0 / 8.5, gain_dn=1.0 / 8.5)
"""Of a D80, without the paper's texture."""


class DotBench:
    """Photographs dots before a D80 at 1 m.

    Parameters
    ----------
    seed
        Of noise, phases and directions.
    texture
        Relative standard deviation of the paper texture.

    Raises
    ------
    UsageError
        No simulator is installed.
    """

    white_dn: float = 0.825 * 2900.0
    """Paper white, mean over a mosaic of the colours' sensitivities."""
    lens_sigma_px: float = 1.25
    """Gaussian that approximates diffraction at f/32 where paper texture is blurred (not where the dot is)."""

    def __init__(self, seed: int, texture: float) -> None:
        self._rng, self._render = np.random.default_rng(seed), renderer()
        self._seed, self._texture = seed, texture
        paper = replace(PLAIN_NOISE, texture=texture, texture_px=TEXTURE_MM * PX_PER_MM / np.sqrt(2.0))
        self.noise: NoiseModel = paper.seen_through(self.lens_sigma_px)
        """Of the images; the fits estimate it from the sharp ones, as those of a folder do."""

    def angle(self) -> float:
        """Any angle."""
        return float(self._rng.uniform(0.0, 2.0 * np.pi))

    def sharp(self, amplitude_mm: float, paper: int) -> SharpTarget:
        """A dot at rest, on a sheet of its own that is seen as far as the motion will reach."""
        # All paper that the motion will bring into the patch; an even number of pixels, as the mosaic repeats.
        beyond = 2 * int(np.ceil(0.6 * amplitude_mm * PX_PER_MM))
        patch = self._photograph(amplitude_mm, paper, None, beyond)
        middle = (patch.shape[0] - 1) / 2 - beyond
        dot = Dot(middle, middle, RADIUS_MM * PX_PER_MM, RADIUS_MM * PX_PER_MM, 0.0, name=f"T{paper}")
        return fit_sharp(dot, [patch])

    def blurred(
        self,
        amplitude_mm: float,
        paper: int,
        cycles: float,
        phase_rad: float,
        *,
        direction_rad: float,
        third: complex = 0.0,
    ) -> Patch:
        """The same dot in motion along a direction (from x upwards), from a phase at the opening on.

        Parameters
        ----------
        third
            Third harmonic over the fundamental: c + i·s of d = sin θ + c sin 3θ + s cos 3θ.
        """
        along = np.array([np.cos(direction_rad), 0.0, np.sin(direction_rad)])

        def motion(t: FloatArray) -> FloatArray:
            theta = 2.0 * np.pi * cycles * t + phase_rad
            course = np.sin(theta) + np.imag(third * np.exp(3j * theta))
            return np.asarray(amplitude_mm * course[:, None] * along, np.float64)

        return self._photograph(amplitude_mm, paper, motion)

    def _photograph(self, amplitude_mm: float, paper: int, motion: object, beyond: int = 0) -> Patch:
        half = int(np.ceil((RADIUS_MM + 1.15 * amplitude_mm) * PX_PER_MM)) + MARGIN_PX + beyond
        # The paper moves with the dot: its edges stay out of the patch. Sheets of another size have another texture.
        sheet = 2 * RADIUS_MM + 8 * amplitude_mm + (2 * MARGIN_PX + 70) / PX_PER_MM
        target = {"name": "T", "centre_mm": (0.0, 0.0, 0.0), "diameter_mm": 2 * RADIUS_MM, "paper_mm": (sheet, sheet)}
        scene = {
            "targets": [target],
            "texture": self._texture,
            "texture_length_mm": TEXTURE_MM,
            "gradient": (0.02, -0.01),
            "vignetting": 0.0,
            "clutter": 0,
            "seed": 1000 * self._seed + paper,
        }
        image = render_dot(self._render, scene, half, motion)
        noise = self._rng.normal(size=image.shape) * np.sqrt(PLAIN_NOISE.variance(image))
        return replace(mosaic_patch(image + noise), origin_px=(-beyond, -beyond))


def render_dot(render: Renderer, scene: Mapping[str, object], half: int, motion: object) -> FloatArray:
    """Mean grey values (2 half + 1 square) of a scene around one dot, T, as a camera 1 m in front sees it.

    Parameters
    ----------
    scene
        Keys of the renderer's scene.
    half
        Pixels from the middle to the edge.
    motion
        Of the dot; None at rest.
    """
    camera = {
        "image_size": (2 * half + 1, 2 * half + 1),
        "focal_px": (1000.0 * PX_PER_MM, 1000.0 * PX_PER_MM),
        "principal_point_px": (half + 0.3, half - 0.2),
        "position_mm": (0.0, -1000.0, 0.0),
    }
    motions = {} if motion is None else {"T": motion}
    return np.asarray(render(scene, camera, motions=motions).mean_dn, np.float64)  # type: ignore[arg-type]


def mosaic_patch(image: FloatArray) -> Patch:
    """Grey values as a patch of a colour mosaic, all of it believed."""
    row, column = np.indices(image.shape)
    return Patch(image, np.asarray(2 * (row % 2) + column % 2, np.uint8), np.ones(image.shape, bool), (0, 0))
