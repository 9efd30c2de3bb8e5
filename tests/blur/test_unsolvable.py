"""One target's equations without a solution cost that target a flag, never the run."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from labdaemon.blur import Dot, fit_sharp, measure_frame
from labdaemon.blur.motion import Measurement, empty_measurement
from labdaemon.blur.patch.pixels import Patch
from labdaemon.blur.sharp.target import SharpTarget
from labdaemon.blur.unsolvable import flag_unsolvable, solved
from labdaemon.flags import Flag

A_PX = (3.0, 2.0)


def patches(area, count: int, seed: int) -> tuple[SharpTarget, list[Patch]]:
    scene = area.Scene(bayer=True)
    centre = (35.27, 34.81)
    still = area.render(scene, (70, 70), centre, seed=seed)
    dot = Dot(centre[0], centre[1], scene.radius_px, scene.radius_px * scene.minor_ratio, 0.0, name="t")
    path = area.whole_cycles(*A_PX, 0.0, 0.0)
    moved = [area.render(scene, (70, 70), centre, path, seed=seed + k + 1, samples=120) for k in range(count)]
    return fit_sharp(dot, [still]), moved


SCREENS = ["4 x 4", "blocks", "huge"]


def screened(kind: str, patch: Patch, rng: np.random.Generator) -> Patch:
    height, width = patch.shape
    screen = {
        "4 x 4": np.tile(rng.uniform(0.05, 1, (4, 4)), (18, 18)),
        "3 x 3": np.tile(rng.uniform(0, 1, (3, 3)), (24, 24)),
        "columns": np.tile([0.0, 1.0], (72, 36)),
        "noise": rng.uniform(0, 1, (72, 72)),
        "blocks": np.kron(rng.integers(0, 2, (18, 18)), np.ones((4, 4))),
        "white": np.full((72, 72), 5.0),
        "huge": np.full((72, 72), 1e300),
    }[kind][:height, :width]
    values = patch.values * screen
    return replace(patch, values=values, valid=patch.valid & (values < 4095) if kind != "huge" else patch.valid)


@pytest.mark.parametrize("kind", SCREENS)
def test_a_target_under_a_screen_is_flagged_or_measured_and_its_neighbours_are_measured(area, kind: str) -> None:
    sharp, moved = patches(area, 3, seed=5)
    rng = np.random.default_rng(9)
    spoilt = [moved[0], screened(kind, moved[1], rng), moved[2]]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = measure_frame([sharp] * 3, spoilt)
    for one in (found[0], found[2]):
        assert np.hypot(*one.a_px) == pytest.approx(np.hypot(*A_PX), abs=0.3) or one.flags
    assert found[1].flags or np.hypot(*found[1].a_px) == pytest.approx(np.hypot(*A_PX), abs=0.3)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("Singular matrix"), FloatingPointError(), MemoryError()])
def test_what_numpy_raises_becomes_a_flag(area, error: Exception) -> None:
    sharp, moved = patches(area, 1, seed=6)

    def fail(target: SharpTarget, patch: Patch) -> Measurement:
        raise error

    found = flag_unsolvable(fail)(sharp, moved[0])
    assert (found.target, found.flags) == ("t", {Flag.POOR_FIT})
    assert np.isnan(found.a_px).all()
    assert solved(fail)(sharp, moved[0]) is None


def test_a_path_that_has_run_away_is_no_result(area) -> None:
    sharp, moved = patches(area, 1, seed=7)

    def run_away(target: SharpTarget, patch: Patch) -> Measurement:
        return replace(empty_measurement(target.name, set()), a_px=np.array([1e4, 0.0]), b_px=np.zeros(2))

    assert flag_unsolvable(run_away)(sharp, moved[0]).flags == {Flag.POOR_FIT}


def test_a_mistake_of_the_program_is_not_hidden(area) -> None:
    def slip(target: SharpTarget, patch: Patch) -> Measurement:
        raise ValueError("a slip")

    sharp, moved = patches(area, 1, seed=8)
    with pytest.raises(ValueError, match="a slip"):
        flag_unsolvable(slip)(sharp, moved[0])
