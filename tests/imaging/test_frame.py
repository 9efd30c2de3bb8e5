from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.imaging.frame import RawFrame, mean_frame

RGGB = np.array([[0, 1], [3, 2]], dtype=np.uint8)


def mosaic(values: np.ndarray, **changes: object) -> RawFrame:
    base: dict[str, object] = {
        "path": Path("a.dng"),
        "values": values,
        "pattern": RGGB,
        "black": np.array([[10.0, 20.0], [30.0, 40.0]]),
        "white_level": 4095.0,
    }
    return RawFrame(**(base | changes))  # type: ignore[arg-type]


def noise(shape: tuple[int, int] = (40, 50), seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(1000, 10, shape).round().astype(np.uint16)


@settings(max_examples=30, deadline=None)
@given(st.integers(-70, 70), st.integers(-70, 70), st.integers(1, 60), st.integers(1, 60))
def test_a_patch_is_the_frame_above_black_and_invalid_beyond_it(x0: int, y0: int, w: int, h: int) -> None:
    frame = mosaic(noise())
    patch = frame.patch(x0, y0, w, h)
    assert patch.shape == (h, w)
    assert patch.origin_px == (x0, y0)
    for y in range(0, h, 7):
        for x in range(0, w, 7):
            gx, gy = x0 + x, y0 + y
            if 0 <= gx < 50 and 0 <= gy < 40:
                assert patch.values[y, x] == frame.values[gy, gx] - frame.black[gy % 2, gx % 2]
            else:
                assert not patch.valid[y, x]
            assert patch.channel[y, x] == RGGB[gy % 2, gx % 2]


def test_saturated_and_hot_pixels_are_invalid_and_nothing_else() -> None:
    values = noise()
    values[10:20, 10:20] = 4095
    values[10, 30] = 3000
    values[30, 31] = 30
    patch = mosaic(values).patch(0, 0, 50, 40)
    expected = np.ones((40, 50), dtype=bool)
    expected[10:20, 10:20] = expected[10, 30] = expected[30, 31] = False
    np.testing.assert_array_equal(patch.valid, expected)


def test_an_edge_is_not_a_hot_pixel() -> None:
    values = noise()
    values[:, 25:] += 2000
    values[20:, :] = values[20:, :] // 2
    assert mosaic(values).whole().valid.all()


def test_grey_takes_the_colour_filter_out_of_neutral_light() -> None:
    rng = np.random.default_rng(1)
    scene = np.repeat(np.repeat(rng.uniform(0.1, 0.9, (15, 20)), 8, axis=0), 8, axis=1)
    yy, xx = np.mgrid[:120, :160]
    gain = np.array([0.5, 1.0, 0.7, 0.98])
    channel = RGGB[yy % 2, xx % 2]
    frame = mosaic((scene * gain[channel] * 3500 + 25).round().astype(np.uint16), black=np.array([[25.0]]))
    np.testing.assert_allclose(frame.gains() / frame.gains()[1], 1.0 / gain, rtol=0.02)
    grey = frame.grey()
    assert grey.dtype == np.float32
    np.testing.assert_allclose(grey / grey.mean(), scene / scene.mean(), rtol=0.03)


def test_mean_of_frames_averages_noise_and_keeps_clipping() -> None:
    frames = []
    for seed in range(9):
        values = noise(seed=seed)
        values[5, 5] = 4095 if seed == 0 else 3900
        frames.append(mosaic(values, path=Path(f"{seed}.dng")))
    mean = mean_frame(frames)
    assert mean.frames == 9
    assert mean.path == Path("0.dng")
    assert mean.values[10:].std() == pytest.approx(10.0 / 3.0, rel=0.1)
    assert mean.saturated()[5, 5]
    assert not mean.patch(0, 0, 10, 10).valid[5, 5]
    assert mean_frame(frames[:1]) is frames[0]


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (mosaic(noise((40, 52)), path=Path("b.dng")), "b.dng.*52x40"),
        (mosaic(noise(), path=Path("b.dng"), white_level=16383.0), "b.dng.*another sensor"),
    ],
)
def test_frames_of_another_camera_are_not_averaged(other: RawFrame, says: str) -> None:
    with pytest.raises(DataError, match=says):
        mean_frame([mosaic(noise()), other])


def test_paper_is_white_where_every_channel_of_a_patch_is_saturated() -> None:
    values = noise()
    assert not mosaic(values).is_white(mosaic(values).whole())
    values[::2, 1::2] = values[1::2, ::2] = 3880  # the greens alone
    greens = mosaic(values, ceilings_dn=np.array([np.inf, 3880, np.inf, 3880]))
    assert not greens.is_white(greens.whole())
    seen, coloured = greens.whole().valid, np.isin(greens.channel(0, 0, 50, 40), (0, 2))
    assert not seen[~coloured].any()
    assert seen[coloured].mean() > 0.98
    values[:, 20:] = 3880
    white = mosaic(values, ceilings_dn=np.full(4, 3880.0))
    assert white.is_white(white.patch(20, 5, 40, 50))
    assert white.is_white(white.patch(-5, -5, 60, 60))
    assert not white.is_white(white.patch(100, 100, 5, 5))
