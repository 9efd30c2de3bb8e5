"""Smears drawn on paper with a renderer of the test's own: discs at random instants, summed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.processing.matched_filter import GreyImage
from labdaemon.processing.target_search import ExpectedTarget, assign, locate_targets, measure_contrast

RADIUS = 10.0


def draw(
    places: np.ndarray, a: np.ndarray, b: np.ndarray, *, size: tuple[int, int] = (700, 900), seed: int = 0
) -> GreyImage:
    """Labels with dots that move, over a background of rectangles that do not."""
    rng = np.random.default_rng(seed)
    base = np.full(size, 0.35, np.float32)
    for _ in range(40):
        x, y = rng.integers(0, size[1]), rng.integers(0, size[0])
        w, h = rng.integers(20, 200, 2)
        base[y : y + h, x : x + w] = rng.uniform(0.1, 0.5)
    dark = np.zeros(size, np.float32)
    for place, va, vb in zip(places, a, b, strict=True):
        reach = np.abs(va) + np.abs(vb) + RADIUS + 14
        low, high = np.maximum((place - reach).astype(int), 0), (place + reach).astype(int)
        base[low[1] : high[1], low[0] : high[0]] = 0.9
        part = dark[low[1] : high[1], low[0] : high[0]]
        for phase in rng.uniform(0, 2 * np.pi, 100):
            x, y = place - low + va * np.sin(phase) + vb * np.cos(phase)
            disc = np.zeros(part.shape, np.float32)
            cv2.circle(disc, (round(x * 16), round(y * 16)), round(RADIUS * 16), 1.0, -1, cv2.LINE_AA, 4)
            part += disc / 100
    picture = base * (1 - 0.9 * np.clip(dark, 0, 1)) + rng.normal(0, 0.01, size)
    return cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8)


def expected(places: np.ndarray) -> list[ExpectedTarget]:
    sharp = draw(places, np.zeros_like(places), np.zeros_like(places))
    plain = [ExpectedTarget(place, RADIUS, RADIUS, 0.0, 1.0) for place in places]
    contrast = measure_contrast(sharp, plain)
    assert np.all(contrast > 0.5)
    assert np.ptp(contrast) < 0.2 * contrast.mean()
    return [replace(one, contrast=float(c)) for one, c in zip(plain, contrast, strict=True)]


def grid(columns: int = 4, rows: int = 3, step: float = 150.0) -> np.ndarray:
    return np.array([(150 + step * i, 150 + step * k) for k in range(rows) for i in range(columns)])


def test_finds_smears_of_any_length_and_direction_where_they_were() -> None:
    places = grid()
    rng = np.random.default_rng(5)
    length, angle = np.linspace(0, 30, len(places)), rng.uniform(0, np.pi, len(places))
    a = np.column_stack([length * np.cos(angle), length * np.sin(angle)])
    b = np.where(np.arange(len(places))[:, None] % 4 == 3, a[:, ::-1] * [1, -1], 0.0)
    found = locate_targets(draw(places, a, b), expected(places))
    for place, va, smear in zip(places, a, found, strict=True):
        assert smear is not None
        assert np.hypot(*(smear.centre_px - place)) < 3
        assert abs(np.hypot(*smear.a_px) - np.hypot(*va)) < 0.3 * RADIUS + 0.25 * np.hypot(*va)


@pytest.mark.parametrize("shift", [(-95.0, 8.0), (70.0, -20.0), (20.0, 90.0)])
def test_finds_a_structure_that_leans_further_than_to_the_next_label(shift: tuple[float, float]) -> None:
    places = grid(step=120.0) + 120.0
    up = (places[:, 1:].max() - places[:, 1:]) / np.ptp(places[:, 1])
    moved = places + up * np.array(shift) + 0.2 * np.array(shift)
    a = np.tile([4.0, 1.0], (len(places), 1))
    found = locate_targets(draw(moved, a, 0 * a), expected(places))
    assert all(smear is not None for smear in found)
    assert max(np.hypot(*(s.centre_px - m)) for s, m in zip(found, moved, strict=True) if s is not None) < 3


def test_never_gives_one_smear_to_two_targets_and_says_when_there_is_none() -> None:
    places = grid()
    here = np.ones(len(places), bool)
    here[[2, 7]] = False
    a = np.tile([6.0, 3.0], (len(places), 1))
    found = locate_targets(draw(places[here], a[here], 0 * a[here]), expected(places))
    assert [smear is not None for smear in found] == here.tolist()


def test_nothing_to_find() -> None:
    places = grid()
    assert locate_targets(np.full((700, 900), 0.9, np.float32), expected(places)) == [None] * len(places)
    assert locate_targets(np.zeros((700, 900), np.float32), expected(places)) == [None] * len(places)
    assert locate_targets(np.zeros((20, 20), np.float32), expected(places)) == [None] * len(places)
    assert locate_targets(np.zeros((700, 900), np.float32), []) == []


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_assignment_survives_clutter_losses_and_lean(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = grid(6, 4, 100.0) + rng.normal(0, 8, (24, 2))
    lean = rng.uniform(-0.15, 0.15, (2, 2))
    true = places + (places - places.mean(axis=0)) @ lean + rng.uniform(-60, 60, 2) + rng.normal(0, 2, (24, 2))
    seen = rng.permutation(24)[:22]
    centres = np.concatenate([true[seen], rng.uniform(0, 800, (10, 2))])
    weight = np.full((24, 32), 0.8)
    chosen = assign(places, centres, weight, least_px=10.0)
    used = chosen[chosen >= 0]
    assert len(set(used.tolist())) == len(used)
    right = {int(target): index for index, target in enumerate(seen)}
    hits = sum(chosen[target] == index for target, index in right.items())
    assert hits >= 21
