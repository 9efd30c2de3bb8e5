from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import DataError
from labdaemon.flags import Flag
from labdaemon.geometry import (
    ImageMotion,
    IntersectedMotion,
    ObjectMotion,
    intersect_motion,
    intersect_targets,
    resolve_ambiguous_targets,
)
from labdaemon.geometry.harmonic import project_motion
from labdaemon.geometry.lens import Lens
from labdaemon.orbit_axes import principal_axes

TWO = [(-500, -1000, 300), (500, -1000, 500)]
THREE = [*TWO, (0, -1100, 900)]
LEVEL = [(-500, -1000, 370), (500, -1000, 370)]
SD_PX = 0.01


def make_cameras(look, places):
    return [look(place, roll=0.1 * i) for i, place in enumerate(places)]


def image(camera, mean, a, b, rng, *, phased: bool = False, sd: float = SD_PX) -> ImageMotion:
    """What a blur measurement reports of this motion: noise, and no more phase than it can see."""
    numbers = project_motion(camera.project_with_jacobians, np.stack([mean, a, b]))[0]
    numbers = numbers + sd * rng.normal(size=6) * ([1, 1, 1, 1, 0, 0] if not np.any(b) and not phased else [1] * 6)
    noise = np.eye(6) * max(sd, 1e-4) ** 2
    if phased:
        return ImageMotion(numbers[:2], numbers[2:4], numbers[4:], noise, True)
    major, minor, noise = principal_axes(numbers[2:4], numbers[4:], noise)
    return ImageMotion(numbers[:2], major * rng.choice([-1.0, 1.0]), minor, noise)


def difference(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Error of a vector whose sign is not observable."""
    return found - true if np.linalg.norm(found - true) < np.linalg.norm(found + true) else found + true


coordinate = st.floats(-5, 5)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    place=st.tuples(st.floats(-150, 150), st.floats(-80, 80), st.floats(150, 600)),
    a=st.tuples(coordinate, coordinate, st.floats(0.5, 2)),
    seed=st.integers(0, 99),
)
def test_straight_motion_comes_back_exactly(look, place, a, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, a = np.array(place), np.array(a)
    cameras = make_cameras(look, TWO)
    joined = intersect_motion(cameras, [image(v, mean, a, 0 * a, rng, sd=0.0) for v in cameras])
    np.testing.assert_allclose(difference(joined.motion.a_mm, a), 0, atol=1e-4)
    np.testing.assert_allclose(joined.motion.mean_mm, mean, atol=1e-4)
    assert joined.motion.flags == frozenset()
    assert joined.motion.a_mm[np.argmax(np.abs(joined.motion.a_mm))] > 0


@settings(max_examples=15, deadline=None, derandomize=True)
@given(a=st.tuples(coordinate, coordinate, coordinate), b=st.tuples(coordinate, coordinate, coordinate))
def test_phased_motion_comes_back_with_its_signs(look, a, b) -> None:
    rng = np.random.default_rng(0)
    mean, a, b = np.array([40.0, 20.0, 300.0]), np.array(a), np.array(b)
    cameras = make_cameras(look, TWO)
    joined = intersect_motion(cameras, [image(v, mean, a, b, rng, phased=True, sd=0.0) for v in cameras])
    np.testing.assert_allclose(joined.motion.a_mm, a, atol=1e-4)
    np.testing.assert_allclose(joined.motion.b_mm, b, atol=1e-4)
    assert joined.resolved_by == "phase"


COUNT = 90
"""Motions drawn for each geometry: enough for the 95 % point and for a spread within a tenth."""


@pytest.mark.parametrize(
    ("places", "kind"), [(TWO, "straight"), (THREE, "straight"), (TWO, "phased"), (THREE, "orbit")]
)
def test_vectors_and_their_stated_uncertainty(look, places, kind: str) -> None:
    """95 % within 0.05 mm, at most 5 % flagged, pulls 0.8 to 1.3, nothing wrong without a flag."""
    rng = np.random.default_rng(21)
    cameras = make_cameras(look, places)
    errors, pulls, flagged = [], [], 0
    for _ in range(COUNT):
        mean = rng.uniform([-150, -80, 150], [150, 80, 600])
        a = rng.normal(0, 1, 3) * [3, 2, 0.5]
        b = np.zeros(3) if kind == "straight" else np.cross(a, rng.normal(0, 1, 3)) * rng.uniform(0.1, 0.5)
        if kind != "phased":
            a, b, _ = principal_axes(a, b, np.zeros((6, 6)))
        if kind == "orbit" and np.linalg.norm(a) < 1.3 * np.linalg.norm(b):
            continue  # a circle has no axes to compare
        joined = intersect_motion(cameras, [image(v, mean, a, b, rng, phased=kind == "phased") for v in cameras])
        if joined.motion.flags:
            flagged += 1
            continue
        sd = np.sqrt(np.diag(joined.motion.covariance_mm2))
        error = joined.motion.a_mm - a if kind == "phased" else difference(joined.motion.a_mm, a)
        errors.append(np.linalg.norm(error))
        pulls.append([*(error / sd[3:6]), *((joined.motion.mean_mm - mean) / sd[:3])])
    assert np.quantile(errors, 0.95) < 0.05
    assert flagged <= 0.05 * COUNT
    assert max(errors) < 0.3
    spread = np.std(pulls, axis=0)
    assert np.all((spread > 0.8) & (spread < 1.3)), spread


def test_camera_uncertainty_reaches_the_vectors(look) -> None:
    """With cameras misplaced by their stated covariance the pulls stay true: it is carried into every row."""
    rng = np.random.default_rng(3)
    cameras = make_cameras(look, TWO)
    half = rng.normal(size=(12, 12)) * np.tile([3e-4, 3e-4, 3e-4, 0.3, 0.3, 0.3], 2)[:, None] / np.sqrt(12)
    covariance = half @ half.T
    pulls, flagged = [], 0
    for _ in range(150):
        mean, a = rng.uniform([-150, -80, 150], [150, 80, 600]), rng.normal(0, 1, 3) * [30, 20, 5]
        shift = half @ rng.normal(size=12)
        seen = [image(v.apply_change(shift[6 * i : 6 * i + 6]), mean, a, 0 * a, rng) for i, v in enumerate(cameras)]
        motion = intersect_motion(cameras, seen, covariance=covariance).motion
        if Flag.AMBIGUOUS in motion.flags:
            flagged += 1
            continue
        sd = np.sqrt(np.diag(motion.covariance_mm2))
        pulls.append([*(difference(motion.a_mm, a) / sd[3:6]), *((motion.mean_mm - mean) / sd[:3])])
    spread = np.std(pulls, axis=0)
    assert np.all((spread > 0.8) & (spread < 1.3)), spread
    assert flagged <= 0.05 * 150


def test_level_cameras_and_level_motion_are_never_silently_wrong(look) -> None:
    """All in the epipolar plane: both ways of matching the ends fit equally well."""
    rng = np.random.default_rng(7)
    cameras = make_cameras(look, LEVEL)
    wrong = 0
    for _ in range(60):
        mean = np.array([rng.uniform(-100, 100), rng.uniform(-60, 60), 370.0])
        a = np.array([*rng.normal(0, 2, 2), 0.0])
        joined = intersect_motion(cameras, [image(v, mean, a, 0 * a, rng) for v in cameras])
        apart = np.linalg.norm(difference(joined.motion.a_mm, a))
        if Flag.AMBIGUOUS in joined.motion.flags:
            assert joined.alternative is not None
            apart = min(apart, np.linalg.norm(difference(joined.alternative.a_mm, a)))
            assert joined.motion.residual_ratio is not None
            assert joined.motion.residual_ratio < 30
        wrong += apart > 0.1
    assert wrong == 0


def test_a_third_camera_settles_it(look) -> None:
    rng = np.random.default_rng(7)
    cameras = make_cameras(look, [*LEVEL, (0, -1100, 900)])
    mean, a = np.array([20.0, 10.0, 370.0]), np.array([3.0, 1.0, 0.0])
    joined = intersect_motion(cameras, [image(v, mean, a, 0 * a, rng) for v in cameras])
    assert joined.resolved_by == "third camera"
    assert Flag.AMBIGUOUS not in joined.motion.flags
    np.testing.assert_allclose(joined.motion.a_mm, a, atol=0.03)


def test_phase_settles_it(look) -> None:
    rng = np.random.default_rng(7)
    cameras = make_cameras(look, LEVEL)
    mean, a = np.array([20.0, 10.0, 370.0]), np.array([-3.0, 1.0, 0.0])
    joined = intersect_motion(cameras, [image(v, mean, a, 0.2 * a, rng, phased=True) for v in cameras])
    assert joined.resolved_by == "phase"
    np.testing.assert_allclose(joined.motion.a_mm, a, atol=0.03)


def test_signed_vectors_that_contradict_each_other_are_flagged(look) -> None:
    """One camera took the mirrored orbit: the redundancy shows it, but not which camera."""
    rng = np.random.default_rng(7)
    cameras = make_cameras(look, TWO)
    mean, a, b = np.array([20.0, 10.0, 250.0]), np.array([-3.0, 1.0, 0.4]), np.array([0.4, 0.8, 1.2])
    seen = [image(v, mean, a, b, rng, phased=True) for v in cameras]
    assert not intersect_motion(cameras, seen).motion.flags
    mirrored = ImageMotion(seen[1].mean_px, seen[1].a_px, -seen[1].b_px, seen[1].covariance_px2, True)
    joined = intersect_motion(cameras, [seen[0], mirrored])
    assert Flag.AMBIGUOUS in joined.motion.flags
    assert joined.resolved_by == ""


def test_continuity_along_a_member_resolves_a_match(look) -> None:
    """A column swaying in X: at the cameras' height the match is open, above and below it is not."""
    rng = np.random.default_rng(1)
    cameras = dict(zip("lr", make_cameras(look, LEVEL), strict=True))
    heights = np.array([200.0, 250.0, 300.0, 370.0, 440.0, 500.0])
    shape = {f"C{i}": np.array([4.0, 0.3, 0.0]) * height / 400 for i, height in enumerate(heights)}
    shape = {name: a + np.array([0.0, 0.0, 0.3 * (i != 3)]) for i, (name, a) in enumerate(shape.items())}
    images = {
        name: {key: image(camera, np.array([30.0, 5.0, heights[i]]), a, 0 * a, rng) for key, camera in cameras.items()}
        for i, (name, a) in enumerate(shape.items())
    }
    open_ones = [
        n for n, seen in images.items() if intersect_motion(list(cameras.values()), list(seen.values())).alternative
    ]
    assert open_ones == ["C3"]
    result = intersect_targets(cameras, images, members=dict.fromkeys(shape, "column"))
    assert result.resolved_by["C3"] == "continuity"
    for name, a in shape.items():
        assert Flag.AMBIGUOUS not in result.motions[name].flags
        np.testing.assert_allclose(result.motions[name].a_mm, a, atol=0.03)


def test_continuity_does_not_guess(look) -> None:
    """Neighbours that disagree, belong to another member or are too few settle nothing."""
    nothing = np.zeros((9, 9))

    def motion(x: float, a: tuple[float, float, float], *flags: Flag) -> ObjectMotion:
        return ObjectMotion(np.array([x, 0, 0]), np.array(a), np.zeros(3), nothing, 1.1, frozenset(flags))

    unsettled = IntersectedMotion(motion(50, (2, 0, 0), Flag.AMBIGUOUS), motion(50, (0, 2, 0)))
    disagree = {
        "a": IntersectedMotion(motion(0, (2, 0, 0))),
        "b": IntersectedMotion(motion(100, (0, 2, 0))),
        "x": unsettled,
    }
    assert resolve_ambiguous_targets(disagree)["x"] is unsettled
    agree = {
        "a": IntersectedMotion(motion(0, (2, 0, 0))),
        "b": IntersectedMotion(motion(100, (2, 0, 0))),
        "x": unsettled,
    }
    assert resolve_ambiguous_targets(agree)["x"].resolved_by == "continuity"
    assert resolve_ambiguous_targets(agree, {"a": "1", "b": "1", "x": "2"})["x"] is unsettled
    assert resolve_ambiguous_targets({"a": agree["a"], "x": unsettled})["x"] is unsettled
    alone = {"x": unsettled, "y": unsettled}
    assert resolve_ambiguous_targets(alone) == alone


def test_an_orbit_seen_by_two_cameras_is_flagged_with_both_roots(look) -> None:
    rng = np.random.default_rng(5)
    cameras = make_cameras(look, TWO)
    mean, a, b = np.array([20.0, 10.0, 250.0]), np.array([3.0, 0.5, 1.0]), np.array([-0.3, 1.2, 0.4])
    b = b - (a @ b) / (a @ a) * a
    joined = intersect_motion(cameras, [image(v, mean, a, b, rng) for v in cameras])
    assert Flag.AMBIGUOUS in joined.motion.flags
    assert joined.alternative is not None
    apart = [np.linalg.norm(difference(m.a_mm, a)) for m in (joined.motion, joined.alternative)]
    assert min(apart) < 0.05
    third = make_cameras(look, THREE)
    settled = intersect_motion(third, [image(v, mean, a, b, rng) for v in third])
    assert settled.resolved_by == "third camera"
    np.testing.assert_allclose(difference(settled.motion.b_mm, b), 0, atol=0.05)


def test_a_target_seen_by_one_camera_only(look) -> None:
    rng = np.random.default_rng(5)
    cameras = dict(zip("lr", make_cameras(look, TWO), strict=True))
    mean, a = np.array([20.0, 10.0, 250.0]), np.array([3.0, 0.5, 0.1])
    seen = {key: image(camera, mean, a, 0 * a, rng) for key, camera in cameras.items()}
    lost = ImageMotion(*[np.full(2, np.nan)] * 3, np.full((6, 6), np.nan))
    result = intersect_targets(cameras, {"both": seen, "one": {"l": seen["l"]}, "lost": {"l": seen["l"], "r": lost}})
    assert set(result.refused) == {"one", "lost"}
    assert all("one camera only" in reason for reason in result.refused.values())
    assert np.isnan(result.motions["one"].a_mm).all()
    assert np.isfinite(result.motions["both"].a_mm).all()


def test_two_different_targets_under_one_name_are_flagged(look) -> None:
    rng = np.random.default_rng(5)
    cameras = make_cameras(look, TWO)
    a = np.array([3.0, 0.5, 0.1])
    first = image(cameras[0], np.array([20.0, 10.0, 250.0]), a, 0 * a, rng)
    second = image(cameras[1], np.array([20.0, 10.0, 290.0]), a, 0 * a, rng)
    assert Flag.POOR_FIT in intersect_motion(cameras, [first, second]).motion.flags


def test_parallel_rays_are_refused(look) -> None:
    rng = np.random.default_rng(5)
    cameras = make_cameras(look, [(0, -1000, 300), (5, -1000, 300)])
    a = np.array([3.0, 0.5, 0.1])
    seen = [image(v, np.array([20.0, 10.0, 250.0]), a, 0 * a, rng) for v in cameras]
    with pytest.raises(DataError, match="nearly parallel"):
        intersect_motion(cameras, seen)


def swaying_frame(look, rng, *, vectors) -> tuple[dict, dict]:
    """Two columns seen by cameras of almost one height; the motion of some targets lies in the epipolar plane."""
    cameras = {"l": look((-450, -900, 419), at=(0, 0, 360)), "r": look((480, -900, 330), at=(0, 0, 360))}
    true, images = {}, {}
    for level in range(6):
        for x in (-75.0, 75.0):
            name, mean = f"{level}{'l' if x < 0 else 'r'}", np.array([x, 0.0, 140 + 80.0 * level])
            true[name] = vectors(rng, level, x)
            images[name] = {c: image(v, mean, true[name], 0 * mean, rng, sd=0.007) for c, v in cameras.items()}
    return true, {"views": cameras, "images": images}


def test_motion_like_the_others_settles_a_chance_ambiguity(look) -> None:
    """At least 95 % of the targets unflagged, none of them wrong, over many structures that move mostly in X."""
    rng = np.random.default_rng(40)
    total = flagged = wrong = settled = 0
    for _ in range(15):
        true, seen = swaying_frame(
            look, rng, vectors=lambda r, level, x: np.array([r.uniform(0.8, 3.4), r.normal(0, 0.8), r.normal(0, 0.13)])
        )
        result = intersect_targets(seen["views"], seen["images"])
        for name, a in true.items():
            motion = result.motions[name]
            total += 1
            settled += result.resolved_by[name] == "continuity"
            if Flag.AMBIGUOUS in motion.flags:
                flagged += 1
            else:
                wrong += np.linalg.norm(difference(motion.a_mm, a)) > 0.1
    assert wrong == 0
    assert flagged < 0.05 * total
    assert settled > 0


def test_a_column_that_is_open_as_a_whole_is_not_settled_by_another(look) -> None:
    """One column sways along the base line of level cameras (open), the other across it (settled)."""
    rng = np.random.default_rng(41)
    wrong = 0
    for _ in range(8):
        cameras = {"l": look((-450, -900, 360), at=(0, 0, 360)), "r": look((480, -900, 360), at=(0, 0, 360))}
        true, images = {}, {}
        for level in range(7):
            for x in (-75.0, 75.0):
                name, mean = f"{level}{x:+.0f}", np.array([x, 0.0, 120 + 80.0 * level])
                true[name] = np.array([2.0, 0.0, 0.0]) if x < 0 else np.array([0.0, 2.0 + 0.3 * level, 0.0])
                true[name] = true[name] + rng.normal(0, 0.02, 3)
                images[name] = {c: image(v, mean, true[name], 0 * mean, rng, sd=0.007) for c, v in cameras.items()}
        result = intersect_targets(cameras, images)
        for name, a in true.items():
            motion = result.motions[name]
            wrong += not motion.flags and np.linalg.norm(difference(motion.a_mm, a)) > 0.15
    assert wrong == 0


def blur_measurement(camera, mean, a, b, rng, sd_moment: float = 0.02, sd_px: float = 0.012) -> ImageMotion:
    """What a fit by second moments reports: no minor axis below three standard deviations."""
    numbers = project_motion(camera.project_with_jacobians, np.stack([mean, a, b]))[0]
    major, minor, _ = principal_axes(numbers[2:4], numbers[4:], np.zeros((4, 4)))
    along = major / np.linalg.norm(major)
    across = np.array([-along[1], along[0]])
    covariance = np.eye(6) * sd_px**2
    cost = float(minor @ minor) + rng.normal(0, sd_moment)
    seen = cost > 3 * sd_moment
    length = np.sqrt(cost) if seen else 0.0
    sd_minor = sd_moment / (2 * length) if seen else np.sqrt(sd_moment)
    covariance[4:, 4:] = sd_minor**2 * np.outer(across, across)
    a_px = major + rng.normal(0, sd_px, 2)
    return ImageMotion(numbers[:2] + rng.normal(0, sd_px, 2), a_px, length * across, covariance)


@pytest.mark.parametrize("seed", range(3))
def test_orbits_too_small_for_one_camera_are_found_by_three(look, seed: int) -> None:
    """Short orbits whose minor axis no image shows for sure: nothing wrong without a flag, b within its sd."""
    rng = np.random.default_rng(seed)
    cameras = [look(place, lens=Lens((1936, 1296), (1968.8, 1968.8), (970.0, 650.0))) for place in THREE]
    off, minor_pulls = [], []
    for _ in range(40):
        mean = rng.uniform([-150, -80, 150], [150, 80, 600])
        a = rng.normal(0, 1, 3)
        a *= np.exp(rng.uniform(np.log(0.3), np.log(2.0))) / np.linalg.norm(a)
        b = np.cross(a, rng.normal(0, 1, 3))
        b *= 0.4 * np.linalg.norm(a) / np.linalg.norm(b)
        joined = intersect_motion(cameras, [blur_measurement(v, mean, a, b, rng) for v in cameras])
        if joined.motion.flags:
            continue
        size, error = np.linalg.norm(a), np.linalg.norm(difference(joined.motion.a_mm, a))
        off.append(error > 0.1 * size + 0.1)
        sd = np.sqrt(np.diag(joined.motion.covariance_mm2)[6:])
        minor_pulls.append(difference(joined.motion.b_mm, b) / sd)
    assert len(off) >= 30
    assert sum(off) <= 1
    assert np.quantile(np.abs(minor_pulls), 0.95) < 4


def test_a_minor_axis_of_zero_says_how_large_it_may_be(look) -> None:
    """Straight to the images: b is 0, and its sd is what the images leave open."""
    rng = np.random.default_rng(2)
    cameras = make_cameras(look, THREE)
    mean, a = np.array([20.0, 10.0, 370.0]), np.array([3.0, 0.5, 0.3])
    joined = intersect_motion(cameras, [blur_measurement(v, mean, a, 0 * a, rng) for v in cameras])
    spread = joined.motion.covariance_mm2[6:, 6:]
    along = a / np.linalg.norm(a)
    assert np.all(joined.motion.b_mm == 0)
    assert along @ spread @ along < 0.01**2  # at right angles to a by definition
    assert np.sqrt(np.trace(spread)) > 0.02  # the root of what a square of 0.02 px² leaves open, 0.14 px
    assert np.sqrt(np.trace(spread)) < 0.5
