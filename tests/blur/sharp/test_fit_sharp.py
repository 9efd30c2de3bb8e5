from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import Dot, fit_sharp
from labdaemon.flags import Flag

SIZE, CENTRE, RADIUS = (90, 90), (44.2, 45.1), 12.0
DOT = Dot(*CENTRE, RADIUS, RADIUS, 0.0, paper_px=60.0)


@pytest.mark.parametrize("length_px", [1.2, 2.0])
def test_strong_grain_does_not_use_up_the_noise(area, length_px):
    for seed in range(3):
        scene = area.Scene(radius_px=RADIUS, texture=0.03, texture_px=length_px, texture_seed=seed)
        sharp = fit_sharp(DOT, [area.render(scene, SIZE, CENTRE, seed=10 + seed)])
        white = np.array(scene.white_dn[0])
        assert 0.5 < sharp.noise.variance(white) / scene.noise.variance(white) < 3.0


def test_grain_is_no_relief_and_a_rough_edge_is(area):
    scene = area.Scene(radius_px=RADIUS, texture=0.017, texture_px=1.5)
    patch = area.render(scene, SIZE, CENTRE, seed=1)
    grainy = fit_sharp(DOT, [patch])
    assert grainy.form.template_residual is None
    assert grainy.texture_map is not None
    assert not grainy.flags
    smooth = area.render(replace(scene, texture=0.0), SIZE, CENTRE, seed=1)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    notch = np.exp(-((x - CENTRE[0] - RADIUS) ** 2 + (y - CENTRE[1]) ** 2) / (2 * 1.5**2))
    rough = fit_sharp(DOT, [replace(smooth, values=smooth.values * (1 - 0.4 * notch))])
    assert rough.form.template_residual is not None
    assert Flag.NOT_FOUND not in rough.flags
