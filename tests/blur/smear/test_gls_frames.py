from dataclasses import replace

import numpy as np
from scipy import ndimage

from labdaemon.blur import Defocus, Dot, ExposureWindow, fit_sharp, measure_group

SHAPE, CENTRE, RADIUS, TEXTURE = (84, 84), (42.3, 41.6), 12.0, 0.006
WINDOWS = [ExposureWindow(5.5, 1.0, phase) for phase in (0.0, np.pi / 2)]


def textured(patch, seed):
    """A patch on paper whose texture stays where it is, dots moving or not."""
    texture = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), 5.0)
    return replace(patch, values=patch.values * (1 + TEXTURE * texture / texture.std()))


def test_signed_vectors_of_long_paths_over_textured_paper_lie_within_their_sd(area):
    scene = area.Scene(radius_px=RADIUS)
    pulls = []
    for seed, (length, phase) in enumerate([(6.0, 0.0), (9.0, 0.4), (12.0, 3.6), (10.0, 1.6)]):
        sharp = fit_sharp(
            Dot(42, 42, RADIUS, RADIUS, 0.0, name="t"),
            [textured(area.render(scene, SHAPE, CENTRE, seed=50 + seed), seed)],
            noise=scene.noise,
        )
        a, b = length * np.cos(phase), length * np.sin(phase)
        frames = [
            textured(
                area.render(
                    scene,
                    SHAPE,
                    CENTRE,
                    area.part_cycles(a, 0.0, b, 0.0, 5.5, window.phase_rad),
                    seed=10 * seed + k,
                    samples=440,
                ),
                seed,
            )
            for k, window in enumerate(WINDOWS)
        ]
        found = measure_group(sharp, frames, WINDOWS, defocus=Defocus(0.0, 0.01))
        sd = np.sqrt(np.diag(found.covariance_px2))
        pulls += [(found.a_px[0] - a) / sd[2], (found.b_px[0] - b) / sd[4]]
    # Weights for independent noise make this 4.4.
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7
