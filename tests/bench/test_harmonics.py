"""The bench of a table with harmonics reaches its goal: bias within 0.1 % where the gauge shows the harmonic."""

import numpy as np
import pytest

from labdaemon.bench.harmonics import HarmonicTrials, record_harmonics, run_harmonics


def test_a_five_percent_third_harmonic_leaves_a_thousandth() -> None:
    found = run_harmonics(0.8, 3, noise=False)
    assert np.abs(found.with_gauge).max() < 1e-3
    assert HarmonicTrials.rms(found.without) > 4e-3


def test_the_gauge_shows_the_harmonic_within_its_sd() -> None:
    rng, pulls = np.random.default_rng(2), []
    for delta in np.linspace(0, 6, 25):
        one = record_harmonics(rng, 1.0, 0.05, float(delta))
        pulls += [(one.cosine[1] - 0.05 * np.cos(delta)) / one.sd[1], (one.sine[1] - 0.05 * np.sin(delta)) / one.sd[1]]
    assert float(np.std(pulls)) == pytest.approx(1.0, abs=0.35)
