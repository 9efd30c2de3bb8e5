"""One dot from two arrays: ``python dot_from_arrays.py [AMPLITUDE_PX]``.

The images are made here from the definition: a black disc on white paper, averaged over the instants of a sinusoidal
motion.
The measurement knows nothing of that.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

import labdaemon as ld

SIDE, RADIUS, CENTRE = 96, 11.0, (47.3, 48.1)


def dot_image(amplitude_px: float, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Linear 12-bit values of a dot that vibrates along 30 degrees during the exposure."""
    fine = 5  # sub-pixels per pixel and axis: the disc's edge is averaged over each pixel
    axis = (np.arange(SIDE * fine) + 0.5) / fine - 0.5
    x, y = np.meshgrid(axis, axis)
    covered = np.zeros((SIDE * fine, SIDE * fine))
    instants = np.sin(2 * np.pi * (np.arange(120) + 0.5) / 120)
    for place in amplitude_px * instants:
        dx, dy = place * np.cos(np.pi / 6), place * np.sin(np.pi / 6)
        covered += np.hypot(x - CENTRE[0] - dx, y - CENTRE[1] - dy) < RADIUS
    covered = covered.reshape(SIDE, fine, SIDE, fine).mean(axis=(1, 3)) / len(instants)
    light = 2800.0 * (1.0 - 0.92 * covered)
    noisy = light + rng.normal(size=light.shape) * np.sqrt(4.0 + light / 8.5)
    return np.clip(np.round(noisy), 0, 4095).astype(np.uint16)


def main(amplitude_px: float = 4.0) -> ld.Measurement:
    """Print the truth and the measurement."""
    rng = np.random.default_rng(1)
    sharp, blurred = (
        ld.frame_from_array(dot_image(amplitude, rng), white_level=4095) for amplitude in (0.0, amplitude_px)
    )
    [dot] = ld.measure(sharp, blurred)
    angle = np.degrees(np.arctan2(dot.a_px[1], dot.a_px[0]))
    print(f"true     {amplitude_px:.3f} px at 30.00 degrees")
    print(f"measured {dot.amplitude_px:.3f} ± {dot.sd_px:.3f} px at {angle:.2f} degrees")
    return dot


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 4.0)
