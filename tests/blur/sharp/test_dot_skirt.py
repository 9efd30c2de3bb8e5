"""The diffracted skirts of a dot are no paper texture."""

import numpy as np

from labdaemon.bench.dots import DotBench


def test_skirts_on_paper_without_texture_are_none() -> None:
    sharp = DotBench(5, 0.0).sharp(3.0, 0)
    assert sharp.noise.texture == 0.0
    assert sharp.texture_map is None


def test_the_texture_that_a_lens_shows_is_found_beside_them() -> None:
    bench = DotBench(6, 0.004)
    seen = bench.sharp(3.0, 0).noise
    at_zero = [noise.texture * noise.texture_px for noise in (seen, bench.noise)]
    np.testing.assert_allclose(at_zero[0], at_zero[1], rtol=0.25)
