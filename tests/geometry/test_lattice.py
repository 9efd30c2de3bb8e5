from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.geometry.lattice import apply_placement, grow_lattice, place_lattices
from labdaemon.geometry.lens import Lens


def photograph(
    look, tilt: tuple[float, float], roll: float, lens: Lens, side: int = 9
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and nodes of a sheet of side × side dots, 40 mm apart in the plane y = 0 and seen from its front."""
    i, j = np.meshgrid(np.arange(side), np.arange(side))
    nodes = np.column_stack([i.ravel(), j.ravel()])
    sheet = np.column_stack([40.0 * nodes[:, 0], np.zeros(side**2), -40.0 * nodes[:, 1]])
    centre = sheet.mean(axis=0)
    camera = look(
        centre + np.array([700 * np.sin(tilt[0]), -900.0, 700 * np.sin(tilt[1])]), at=centre, roll=roll, lens=lens
    )
    return camera.project(sheet), nodes


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    tilt=st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)),
    roll=st.floats(-3.1, 3.1),
    missing=st.sets(st.integers(0, 80), max_size=6),
    seed=st.integers(0, 1000),
)
def test_every_dot_gets_its_node(look, tilt, roll: float, missing: set[int], seed: int) -> None:
    """Any view, a strongly distorting lens, dots missing, dots in any order: one placement explains all nodes."""
    lens = Lens((3872, 2592), (2800.0, 2800.0), (1935.5, 1295.5), (-0.25, 0.1, 0.0, 0.0, 0.0))
    pixels, nodes = photograph(look, tilt, roll, lens)
    keep = np.array([k for k in np.random.default_rng(seed).permutation(81) if k not in missing])
    found = grow_lattice(pixels[keep])
    assert len(found) >= 0.9 * len(keep)
    marks = [{str(k): tuple(nodes[k]) for k in keep.tolist()}]
    marks.append({str(keep[row]): node for node, row in found.items()})
    placements = place_lattices(marks)
    assert placements[1] is not None
    assert {apply_placement(node, placements[1]): str(keep[row]) for node, row in found.items()} == {
        tuple(nodes[keep[row]]): str(keep[row]) for row in found.values()
    }


def test_placement_needs_two_marks_that_agree() -> None:
    marks = [
        {"a": (0, 0), "b": (3, 0), "c": (0, 4)},
        {"a": (5, 5), "b": (5, 8)},  # a quarter turn
        {"a": (1, 1)},
        {"a": (0, 0), "b": (0, 2)},  # another distance: misread
        {"d": (0, 0), "b": (0, 0), "c": (-3, 4)},
    ]
    marks[4] = {"d": (7, 7), "b": (0, 0), "c": (-3, 4)}
    placements = place_lattices(marks)
    assert placements[0] == (0, 0, 0)
    assert apply_placement((5, 5), placements[1]) == (0, 0)
    assert apply_placement((5, 8), placements[1]) == (3, 0)
    assert placements[2] is None
    assert placements[3] is None
    assert apply_placement((7, 7), placements[4]) == (10, 7)


def test_few_or_no_dots() -> None:
    assert grow_lattice(np.zeros((0, 2))) == {}
    assert grow_lattice(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])) == {}
    assert place_lattices([]) == []


@pytest.mark.parametrize("seed", range(3))
def test_scattered_dots_are_no_lattice(seed: int) -> None:
    scattered = np.random.default_rng(seed).uniform(0, 1000, (60, 2))
    assert len(grow_lattice(scattered)) < 20
