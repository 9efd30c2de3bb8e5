from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.geometry.lens import Lens
from labdaemon.geometry.oriented_camera import OrientedCamera
from labdaemon.processing.correspond import DetectedDots, Track, correspond, intersect_rays
from labdaemon.processing.naming import keep_names, match_places, names_in_image, names_in_space

LENS = Lens((3872, 2592), (3937.0, 3937.0), (1935.0, 1295.0), (-0.09, 0.07, 0.0003, -0.0002, 0.0))
FAR_LEFT, FAR_RIGHT, ABOVE = (-500.0, -1000.0, 350.0), (500.0, -1000.0, 350.0), (0.0, -1000.0, 750.0)


def look(position: tuple[float, float, float]) -> OrientedCamera:
    place = np.array(position)
    forward = np.array([0.0, 0.0, 350.0]) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    return OrientedCamera(LENS, rotation, place, np.diag([1e-10] * 3 + [1e-4] * 3))


def structure(seed: int, columns: int = 6, rows: int = 5, step: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, z = np.meshgrid((np.arange(columns) - columns / 2) * step, 350 + (np.arange(rows) - rows / 2) * step)
    places = np.column_stack([x.ravel(), rng.normal(0, 15, x.size), z.ravel()])
    return places, rng.choice([5.0, 8.0, 12.0], len(places))


def see(view: OrientedCamera, places: np.ndarray, sizes: np.ndarray, rng: np.random.Generator, lost: int, clutter: int):
    """Dots of one camera in random order, some lost, some that are not targets, and which target each is."""
    pixels = view.project(places) + rng.normal(0, 0.03, (len(places), 2))
    radius = sizes / 2 * 3937 / view.to_camera_axes(places)[:, 2] * rng.normal(1.01, 0.003, len(places))
    kept = rng.permutation(len(places))[lost:]
    pixels = np.concatenate([pixels[kept], rng.uniform(200, 2300, (clutter, 2))])
    radius = np.concatenate([radius[kept], rng.uniform(6, 30, clutter)])
    return DetectedDots(view, pixels, radius), np.concatenate([kept, np.full(clutter, -1)])


def score(tracks: list[Track], who: list[np.ndarray]) -> tuple[int, int]:
    """(right, silently wrong)."""
    right = wrong = 0
    for track in tracks:
        targets = {int(who[c][dot]) for c, dot in enumerate(track.dots) if dot >= 0}
        good = len(targets) == 1 and targets != {-1}
        right += good
        wrong += not good and track.sure
    return right, wrong


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([(FAR_LEFT, FAR_RIGHT), (FAR_LEFT, FAR_RIGHT, ABOVE)]))
def test_matches_every_target_and_is_never_silently_wrong(seed: int, stands: tuple) -> None:
    rng = np.random.default_rng(seed)
    places, sizes = structure(seed)
    seen, who = zip(*(see(look(stand), places, sizes, rng, lost=1, clutter=2) for stand in stands), strict=True)
    tracks = correspond(seen, [5.0, 8.0, 12.0])
    right, wrong = score(tracks, list(who))
    assert right >= len(places) - 3
    assert wrong <= 1  # a speck of clutter may by chance lie on another's ray at a target's size
    dots = [(c, dot) for track in tracks for c, dot in enumerate(track.dots) if dot >= 0]
    assert len(dots) == len(set(dots))


def test_places_are_where_the_targets_are() -> None:
    places, sizes = structure(3)
    rng = np.random.default_rng(3)
    seen, who = zip(*(see(look(s), places, sizes, rng, 0, 0) for s in (FAR_LEFT, FAR_RIGHT)), strict=True)
    for track in correspond(seen, [5.0, 8.0, 12.0]):
        assert np.linalg.norm(track.place_mm - places[who[0][track.dots[0]]]) < 0.2


def test_two_dots_that_could_be_either_are_marked() -> None:
    # Level cameras, one row, sizes of no help: both pairings of the two dots intersect_rays equally well.
    views = (look(FAR_LEFT), look(FAR_RIGHT))
    places = np.array([[-2.0, 0.0, 350.0], [2.0, 0.0, 350.0]])
    seen = []
    for view in views:
        radius = 8.0 / 2 * 3937 / view.to_camera_axes(places)[:, 2]
        seen.append(DetectedDots(view, view.project(places), radius))
    tracks = correspond(seen, [8.0])
    assert len(tracks) == 2
    assert not any(track.sure for track in tracks)


def test_nothing_seen_nothing_matched() -> None:
    empty = DetectedDots(look(FAR_LEFT), np.empty((0, 2)), np.empty(0))
    assert correspond([empty, empty], [8.0]) == []


def test_rays_meet_and_one_ray_does_not() -> None:
    places, _ = structure(1)
    views = [look(FAR_LEFT), look(FAR_RIGHT)]
    pixels = np.stack([view.project(places) for view in views])
    pixels[1, 0] = np.nan
    met = intersect_rays(views, pixels)
    assert np.isnan(met[0]).all()
    assert np.abs(met[1:] - places[1:]).max() < 1e-6


def test_names_go_by_place_and_stay() -> None:
    places, _ = structure(2)
    names = names_in_space(places)
    top_left = np.lexsort((places[:, 0], -places[:, 2]))[0]
    assert names[top_left] == "T01"
    assert len(set(names)) == len(names)
    order = np.random.default_rng(0).permutation(len(places))
    moved = places[order] + np.random.default_rng(1).normal(0, 0.5, places.shape)
    assert names_in_space(moved) == [names[i] for i in order]
    later = np.concatenate([moved[3:], [[900.0, 0.0, 900.0]]])
    again = keep_names(later, places, tuple(names), 15.0)
    assert again[:-1] == [names[i] for i in order[3:]]
    assert again[-1] not in names
    assert names_in_image(np.array([[500.0, 90.0], [10.0, 100.0], [20.0, 400.0]])) == ["T02", "T01", "T03"]
    assert names_in_space(np.empty((0, 3))) == []


@pytest.mark.parametrize("off_mm", [0.0, 8.0])
def test_approximate_places_name_dots_where_they_lie(off_mm: float) -> None:
    places, sizes = structure(4)
    view = look(FAR_LEFT)
    dots, who = see(view, places, sizes, np.random.default_rng(4), lost=3, clutter=0)
    wanted = places + np.array([off_mm, 0.0, -off_mm])
    found = match_places(dots, np.concatenate([wanted, [[0.0, -5000.0, 350.0]]]))
    assert found[-1] == -1
    for target, dot in enumerate(found[:-1]):
        assert (who[dot] if dot >= 0 else -1) == (target if target in who else -1)
