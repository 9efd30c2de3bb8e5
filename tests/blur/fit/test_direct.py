"""The accelerated fits give what the direct ones give."""

import numpy as np
import pytest

from labdaemon.blur import Defocus, Dot, fit_sharp
from labdaemon.blur.fit.accelerated import ACCELERATED
from labdaemon.blur.fit.direct import DIRECT
from labdaemon.blur.fit.whole_cycles import measure_whole_cycles
from labdaemon.blur.smear.fit_problem import prepare_fit

CENTRE = (40.13, 38.31)


@pytest.fixture(scope="module")
def scene(area):
    return area.Scene(radius_px=9.6)


@pytest.fixture(scope="module")
def sharp(area, scene):
    patch = area.render(scene, (60, 60), (30.27, 29.81), seed=1)
    return fit_sharp(Dot(30.0, 30.0, 9.6, 9.6, 0.0, name="t"), [patch], noise=scene.noise)


@pytest.mark.parametrize(
    ("motion", "part_of_sd"),
    [
        ((0.0, 0.0, 0.0, 0.0), 0.5),  # at rest the image does not depend on a: the shortcut does not fit it
        ((1.1, -0.5, 0.0, 0.0), 0.05),
        ((7.0, 2.0, 0.0, 0.0), 0.05),
        ((4.0, 1.0, -0.5, 2.0), 0.05),
    ],
)
def test_shortcuts_do_not_change_the_measurement(area, scene, sharp, motion, part_of_sd):
    patch = area.render(scene, (76, 80), CENTRE, area.whole_cycles(*motion), seed=4)
    problem = prepare_fit(sharp, patch, np.array(CENTRE))
    assert problem is not None
    direct, fast = (
        measure_whole_cycles(sharp, patch, problem, Defocus(0.0, 0.01), orbit=True, flags=set(), fits=fits)
        for fits in (DIRECT, ACCELERATED)
    )
    assert direct.flags == fast.flags
    for name, columns in (("centre_px", slice(0, 2)), ("a_px", slice(2, 4)), ("b_px", slice(4, 6))):
        away = getattr(direct, name) - getattr(fast, name)
        sd = np.sqrt(np.diag(direct.covariance_px2)[columns])
        assert np.all(np.abs(away) <= part_of_sd * sd + 1e-9), (name, away / sd)
        variances = [float(np.trace(found.covariance_px2[columns, columns])) for found in (direct, fast)]
        assert variances[1] == pytest.approx(variances[0], rel=0.1, abs=1e-6)
