"""The bench of signed motions: its lines, its cases, and level motion in the simulator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from labdaemon.bench.signed import SignedComparison, SignedResult
from labdaemon.bench.signed_cases import SignedCase, signed_cases
from labdaemon.bench.signed_text import signed_document, signed_lines
from labdrivers.sim.layout import make_layout
from labdrivers.sim.motions import random_motions


def target(error_mm: float = 0.004, *flags: str, space: bool = False, px: float = 3.0) -> SignedComparison:
    nan = math.nan
    bound = (nan, nan, nan) if space else (0.5, 0.4, 0.004)
    return SignedComparison(0.8, px, error_mm, 0.002, 0.4, (0.8, -1.2), *bound, frozenset(flags))


def lines(space: bool, *targets: SignedComparison) -> list[str]:
    case = next(one for one in signed_cases(quick=True) if one.key == ("space" if space else "code"))
    return signed_lines([SignedResult(case, list(targets))])


def test_one_camera_is_compared_with_its_bound() -> None:
    line = lines(False, target(), target(), target(0.9, "ambiguous"))[1]
    assert "2 of 3 unflagged" in line
    assert "phase sd 0.50° stated" in line
    assert "bound 0.40°, 1.00 x the bound (goal 1.3)" in line
    assert "pulls 1.02" in line


def test_a_twin_without_a_flag_is_counted_and_one_with_a_flag_is_not() -> None:
    assert "Twins: 1 wrong without a flag of 3" in lines(False, target(), target(0.9), target(0.9, "ambiguous"))[-1]


def test_ambiguous_targets_count_where_the_image_moves_far() -> None:
    small, large = (target(0.01, "ambiguous", space=True, px=px) for px in (1.5, 4.0))
    line = lines(True, target(space=True), small, large)[1]
    assert "1 of 2 above 2.5 px ambiguous" in line
    assert "95 % within 0.004 mm" in line


def test_nothing_without_a_flag_is_said_and_a_machine_reads_the_same() -> None:
    case = signed_cases(quick=True)[0]
    result = SignedResult(case, [target(0.9, "ambiguous")])
    assert "none of 1 without a flag" in signed_lines([result])[1]
    assert signed_document([result])[case.key]["targets"] == 1


@pytest.mark.parametrize("case", signed_cases(quick=False), ids=lambda case: case.key)
def test_paper_is_as_bright_in_every_frame(case: SignedCase) -> None:
    assert case.white_dn * case.light_fraction == pytest.approx(2900.0)
    options = case.folder_options(7)
    assert options["seed"] == 7
    assert ("light" in options) == bool(case.codes)


def test_level_motion_keeps_to_the_horizontal_plane() -> None:
    scene = make_layout(
        seed=1,
        cameras=2,
        size="small",
        targets=6,
        diameters_mm=(8.0,),
        paper_mm=20.0,
        texture=0.0,
        texture_length_mm=0.3,
        still_paper=False,
        gradient=(0.0, 0.0),
        distance_mm=1000.0,
    ).scene
    motions = random_motions(scene, np.random.default_rng(1), (1.0, 2.0), 0.5, 5.0, 0.0, False, level=True)
    for motion in motions.values():
        assert motion.a_mm[2] == motion.b_mm[2] == 0.0
        assert 1.0 <= np.linalg.norm(np.stack((motion.a_mm, motion.b_mm)), 2) <= 2.0
