"""Ceilings are found where values pile up in noise, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from labdaemon.imaging.ceiling import find_ceilings

RGGB = np.array([[0, 1], [3, 2]], dtype=np.uint8)
GREY = np.zeros((1, 1), dtype=np.uint8)
SHAPE = (400, 600)
D80 = np.unique(np.rint(4095 * (0.6 * np.linspace(0, 1, 683) ** 2 + 0.4 * np.linspace(0, 1, 683)))).astype(int)


def scene(level: float, rng: np.random.Generator, photons_per_dn: float = 8.0) -> np.ndarray:
    """Paper with dark squares, in DN, photon and read noise."""
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = np.where((xx // 40 % 3 == 1) & (yy // 40 % 3 == 1), 0.06 * level, level) * (1 - 0.05 * xx / SHAPE[1])
    return np.asarray(light + rng.normal(size=SHAPE) * np.sqrt(light / photons_per_dn + 0.6))


def counts(light: np.ndarray, clip: float) -> np.ndarray:
    return np.clip(np.rint(light), 0, clip).astype(np.uint16)


@pytest.mark.parametrize("clip", [255, 1023, 3880, 4095, 13584, 15520, 16383])
@pytest.mark.parametrize("over", [1.0, 1.1, 2.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_grey_sensor_s_ceiling_is_where_values_pile_up(clip: int, over: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert find_ceilings(counts(scene(over * clip, rng, 8.0 if clip > 255 else 30.0), clip), GREY) == [clip]


@pytest.mark.parametrize("cell", [RGGB, RGGB[::-1], RGGB[:, ::-1], RGGB[::-1, ::-1]])
def test_each_channel_has_its_own(cell: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    gain = np.array([0.5, 1.0, 0.45, 1.0])[cell][np.arange(SHAPE[0])[:, None] % 2, np.arange(SHAPE[1]) % 2]
    found = find_ceilings(counts(scene(1.3 * 3880, rng) * gain, 3880), cell)
    np.testing.assert_array_equal(found, [np.inf, 3880, np.inf, 3880])


def test_hot_pixels_above_and_a_pile_that_later_corrections_spread() -> None:
    rng = np.random.default_rng(4)
    values = counts(scene(1.2 * 15520, rng, 2.5), 15520)
    spread = np.rint(15518 + 1.5 * rng.normal(size=SHAPE)).astype(np.uint16)
    values = np.where(values == 15520, spread, values)
    values.ravel()[rng.integers(0, values.size, 30)] = 16383
    assert find_ceilings(values, GREY)[0] == pytest.approx(15520, abs=8)


@pytest.mark.parametrize("over", [1.02, 1.5])
def test_a_compression_curve_of_few_levels(over: float) -> None:
    light = scene(over * 3880, np.random.default_rng(5))
    values = D80[np.searchsorted(D80, np.clip(light, 0, 3880))].astype(np.uint16)
    assert find_ceilings(values, GREY) == [D80[np.searchsorted(D80, 3880)]]


def unsaturated(kind: str, rng: np.random.Generator) -> np.ndarray:
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    steps = np.where((xx // 50 + yy // 50) % 2, 200.0, 20.0)
    vignette = 3000 * (1 - 0.3 * ((xx / SHAPE[1] - 0.5) ** 2 + (yy / SHAPE[0] - 0.5) ** 2))
    match kind:
        case "lit":
            return counts(scene(3000, rng), 4095)
        case "curve":
            return D80[np.searchsorted(D80, np.clip(scene(3400, rng), 0, 4095))]
        case "black":
            return np.full(SHAPE, 64)
        case "read noise on black":
            return np.maximum(np.rint(rng.normal(0, 0.8, SHAPE)), 0)
        case "uniform noise":
            return rng.integers(0, 60, SHAPE)
        case "no noise":
            return steps
        case "no noise, light falls off":
            return np.rint(vignette)
        case "little noise":
            return np.rint(steps + 0.45 + rng.normal(0, 0.5, SHAPE))
        case "little noise, light falls off":
            return np.rint(vignette + rng.normal(0, 0.5, SHAPE))
        case "stretched":
            return np.rint(rng.normal(2000, 25, SHAPE)) * 13 // 8
        case "squeezed":
            return np.rint(rng.normal(2000, 25, SHAPE)) * 5 // 8
        case "shifted":
            return counts(scene(3000, rng), 4095).astype(int) * 16
        case _:
            raise AssertionError(kind)


KINDS = ["lit", "curve", "black", "read noise on black", "uniform noise", "no noise", "no noise, light falls off"]
KINDS += ["little noise", "little noise, light falls off", "stretched", "squeezed", "shifted"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pattern", [GREY, RGGB], ids=["grey", "Bayer"])
def test_no_ceiling_where_nothing_clips(kind: str, pattern: np.ndarray) -> None:
    for seed in range(3):
        values = unsaturated(kind, np.random.default_rng(seed)).astype(np.uint16)
        assert np.isinf(find_ceilings(values, pattern)).all()


def test_frames_too_small_to_judge() -> None:
    assert np.isinf(find_ceilings(np.zeros((1, 1), np.uint16), RGGB)).all()
    assert np.isinf(find_ceilings(np.zeros((0, 5), np.uint16), GREY)).all()
