"""Which dot of an image is which node of a square lattice of dots, seen in perspective through a distorting lens.

The lattice is grown from a seed, each step predicted from the last one, so that neither the lens nor the view needs to
be known. A sheet is seen from its printed side, so the lattice's handedness is known; which way round it is, coded
rings among its nodes tell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from labdaemon.geometry.motion import FloatArray

Node = tuple[int, int]
Placement = tuple[int, int, int]
"""Quarter turns, then shift in both directions."""

_TOLERANCE = 0.28
"""How far from its predicted place a node's dot may lie, in parts of the step."""
_STEPS: tuple[Node, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))


def grow_lattice(centres_px: FloatArray) -> dict[Node, int]:
    """Index the nodes of the largest square lattice among some dots.

    Parameters
    ----------
    centres_px
        (n, 2) dots of an image, x right and y down.

    Returns
    -------
    dict
        Node (i, j) -> row of `centres_px`; i and j grow along two sides of the squares, and turning from i to j is
        turning from x to y. Empty when there are fewer than four dots.
    """
    if len(centres_px) < 4:
        return {}
    middle = np.median(centres_px, axis=0)
    seeds = np.argsort(np.linalg.norm(centres_px - middle, axis=1))[:6].tolist()
    grown = [_grow_from_seed(centres_px, seed) for seed in seeds]
    most = max(len(nodes) for nodes in grown)
    # Where a seed's own neighbours are missing a diagonal may be taken for a side: that lattice is as large, but its
    # steps are longer.
    return min(
        (nodes for nodes in grown if 10 * len(nodes) >= 9 * most), key=lambda nodes: _mean_step(centres_px, nodes)
    )


def place_lattices(marks: Sequence[Mapping[str, Node]]) -> list[Placement | None]:
    """Turns and shifts that bring the lattices of several images to one.

    Parameters
    ----------
    marks
        For each image, the nodes of its coded marks by name.

    Returns
    -------
    list
        One placement an image (see `apply_placement`), None where it shares fewer than two marks with the others.
    """
    result: list[Placement | None] = [None] * len(marks)
    if not marks:
        return result
    first = max(range(len(marks)), key=lambda k: len(marks[k]))
    known: dict[str, Node] = dict(marks[first])
    result[first] = (0, 0, 0)
    progress = True
    while progress:
        progress = False
        for k, mine in enumerate(marks):
            shared = [name for name in mine if name in known]
            if result[k] is not None or len(shared) < 2:
                continue
            for turns in range(4):
                turned = {name: apply_placement(node, (turns, 0, 0)) for name, node in mine.items()}
                shifts = {(known[n][0] - turned[n][0], known[n][1] - turned[n][1]) for n in shared}
                if len(shifts) == 1:
                    result[k] = (turns, *shifts.pop())
                    known |= {
                        name: apply_placement(node, result[k]) for name, node in mine.items() if name not in known
                    }
                    progress = True
                    break
    return result


def apply_placement(node: Node, placement: Placement | None) -> Node:
    """Node of the common lattice."""
    if placement is None:
        return node
    i, j = node
    for _ in range(placement[0]):
        i, j = -j, i
    return i + placement[1], j + placement[2]


def _mean_step(centres_px: FloatArray, nodes: Mapping[Node, int]) -> float:
    """Mean distance between neighbours of a lattice."""
    lengths = [
        float(np.linalg.norm(centres_px[nodes[i + di, j + dj]] - centres_px[row]))
        for (i, j), row in nodes.items()
        for di, dj in ((1, 0), (0, 1))
        if (i + di, j + dj) in nodes
    ]
    return float(np.mean(lengths)) if lengths else float("inf")


def _grow_from_seed(centres_px: FloatArray, seed: int) -> dict[Node, int]:
    """Lattice around one dot."""
    basis = _find_basis(centres_px, seed)
    if basis is None:
        return {}
    nodes: dict[Node, int] = {(0, 0): seed}
    taken = {seed}
    steps = {(0, 0): basis}  # local steps to the next i and the next j
    queue = deque([(0, 0)])
    while queue:
        node = queue.popleft()
        here = centres_px[nodes[node]]
        for di, dj in _STEPS:
            there = (node[0] + di, node[1] + dj)
            if there in nodes:
                continue
            step = (di + dj) * steps[node][0 if di else 1]
            behind = (node[0] - di, node[1] - dj)
            if behind in nodes:
                step = here - centres_px[nodes[behind]]
            distances = np.linalg.norm(centres_px - (here + step), axis=1)
            found = int(np.argmin(distances))
            if distances[found] > _TOLERANCE * np.linalg.norm(step) or found in taken:
                continue
            nodes[there] = found
            taken.add(found)
            taken_step = (centres_px[found] - here) * (di + dj)
            steps[there] = (taken_step, steps[node][1]) if di else (steps[node][0], taken_step)
            queue.append(there)
    return nodes


def _find_basis(centres_px: FloatArray, seed: int) -> tuple[FloatArray, FloatArray] | None:
    """Steps to two neighbours of a dot across each other, turning from x to y."""
    offsets = centres_px - centres_px[seed]
    near = np.argsort(np.linalg.norm(offsets, axis=1))[1:9]
    if len(near) < 2:
        return None
    first = offsets[near[0]]
    best, second = 0.0, None
    for index in near[1:]:
        other = offsets[index]
        size = np.linalg.norm(first) * np.linalg.norm(other)
        # A diagonal encloses as large an area as a side does, but is longer.
        score = float(abs(first[0] * other[1] - first[1] * other[0]) / size / np.linalg.norm(other))
        if score > best:
            best, second = score, other
    if second is None:
        return None
    if first[0] * second[1] - first[1] * second[0] < 0:
        second = -second
    return first, second
