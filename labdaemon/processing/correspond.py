"""Which dot of one camera is which of another: rays that meet, sizes that agree, and no dot used twice.

Each pair of dots in two cameras, with whatever other cameras see at the point where their rays meet, is a candidate
target. It costs what its rays miss each other by and what its apparent sizes disagree with its distances; the set of
candidates that explains most dots at least cost is an integer program, solved exactly for every cluster of candidates
that compete for dots. Where the runner-up is hardly worse the match is a guess, and is marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from labdaemon.blur import FloatArray
from labdaemon.geometry import OrientedCamera

SD_PLACE_PX = 0.3
"""How well a dot's centre is known, orientation aside: lens model included."""
SD_SIZE = 0.05
"""How well the true size of dots is known beforehand, relative: printing, ink, blur."""
SD_ONE_SIZE = 0.01
"""How much dots of one print differ at least, relative, once their common size is known."""
SD_RELATIVE_SIZE = 0.02
"""How well the sizes of one dot in two cameras agree, relative."""
GATE_COST = 25.0
"""Cost beyond which dots do not belong together (a sum of squared normalised discrepancies)."""
CLEAR_COST = 9.0
"""How much worse the runner-up must be for a match not to be a guess."""


@dataclass(frozen=True, slots=True, eq=False)
class DetectedDots:
    """The dots of one camera's sharp frame.

    Attributes
    ----------
    view
        The oriented camera.
    centres_px
        (n, 2).
    radius_px
        (n,) semi-major axes: what foreshortening leaves alone.
    """

    view: OrientedCamera
    centres_px: FloatArray
    radius_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One target as several cameras see it.

    Attributes
    ----------
    dots
        Index of its dot in each camera, −1 where it is not seen.
    place_mm
        (3,) where its rays meet.
    sure
        False where another match would fit nearly as well.
    """

    dots: tuple[int, ...]
    place_mm: FloatArray
    sure: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class _TrackCandidate:
    dots: tuple[int, ...]
    place_mm: FloatArray
    cost: float

    @property
    def gain(self) -> float:
        """Dots explained, less the cost: a dot left alone is worth nothing."""
        return GATE_COST * (sum(dot >= 0 for dot in self.dots) - 1) - self.cost


def intersect_rays(views: Sequence[OrientedCamera], pixels: FloatArray) -> FloatArray:
    """Intersect rays in the least-squares sense.

    Parameters
    ----------
    views
        c cameras.
    pixels
        (c, n, 2) of n points; NaN where a camera does not see one.

    Returns
    -------
    array
        (n, 3) mm; NaN where fewer than two cameras see it or the rays are parallel.
    """
    count = pixels.shape[1]
    normal, right, seen = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count)
    for view, px in zip(views, pixels, strict=True):
        known = np.isfinite(px).all(axis=1)
        rays = view.rays(np.where(known[:, None], px, np.array(view.lens.principal_point_px)))
        project = (np.eye(3) - rays[:, :, None] * rays[:, None, :]) * known[:, None, None]
        normal += project
        right += project @ view.position_mm
        seen += known
    usable = (seen >= 2) & (np.abs(np.linalg.det(normal)) > 1e-9)
    place = np.full((count, 3), np.nan)
    place[usable] = np.linalg.solve(normal[usable], right[usable][..., None])[..., 0]
    return place


def correspond(cameras: Sequence[DetectedDots], diameters_mm: Sequence[float]) -> list[Track]:
    """Match the dots of two or more cameras.

    Parameters
    ----------
    cameras
        What each sees.
    diameters_mm
        Sizes of dots in use.

    Returns
    -------
    list of Track
        Each seen by two cameras at least.
    """
    sizes = _NominalSizes(np.log(np.asarray(diameters_mm, dtype=float) / 2), SD_SIZE)
    candidates = _candidates(cameras, sizes)
    tracks = _choose(candidates, cameras)
    if len(tracks) < 4:
        return tracks
    # Dots printed together are larger or smaller than nominal by a common factor; once known, sizes give the distance.
    sizes = sizes.refine(np.array([_log_radius_mm(cameras, track) for track in tracks]))
    return _choose(_candidates(cameras, sizes), cameras)


@dataclass(frozen=True, slots=True, eq=False)
class _NominalSizes:
    """(s,) logarithms of the radii in use (mm), and how well dots keep to them."""

    log_radii: FloatArray
    sd: float

    def cost(self, log_radius: FloatArray) -> FloatArray:
        result: FloatArray = np.min((log_radius[:, None] - self.log_radii[None]) ** 2, axis=1) / self.sd**2
        return result

    def refine(self, log_radius: FloatArray) -> _NominalSizes:
        off = log_radius - self.log_radii[np.argmin(np.abs(log_radius[:, None] - self.log_radii[None]), axis=1)]
        common = float(np.median(off))
        spread = 1.4826 * float(np.median(np.abs(off - common)))
        return _NominalSizes(self.log_radii + common, float(np.clip(1.5 * spread, SD_ONE_SIZE, self.sd)))


def _log_radius_mm(cameras: Sequence[DetectedDots], track: Track) -> float:
    """Logarithm of a track's true radius, mm, by its apparent sizes and its distances."""
    values = [
        np.log(
            camera.radius_px[dot]
            * camera.view.to_camera_axes(track.place_mm[None])[0, 2]
            / np.mean(camera.view.lens.focal_px)
        )
        for camera, dot in zip(cameras, track.dots, strict=True)
        if dot >= 0
    ]
    return float(np.mean(values))


def _choose(candidates: list[_TrackCandidate], cameras: Sequence[DetectedDots]) -> list[Track]:
    return [track for cluster in _conflict_clusters(candidates, cameras) for track in _solve(cluster)]


def _candidates(cameras: Sequence[DetectedDots], sizes: _NominalSizes) -> list[_TrackCandidate]:
    found: dict[tuple[int, ...], _TrackCandidate] = {}
    for p, q in combinations(range(len(cameras)), 2):
        first, second = cameras[p], cameras[q]
        i, j = (index.ravel() for index in np.indices((len(first.centres_px), len(second.centres_px))))
        if not i.size:
            continue
        place = intersect_rays((first.view, second.view), np.stack([first.centres_px[i], second.centres_px[j]]))
        dots = np.full((len(i), len(cameras)), -1)
        dots[:, p], dots[:, q] = i, j
        cost = _cost(cameras, dots, place, sizes)
        for k in np.flatnonzero(cost < GATE_COST):
            pair = _TrackCandidate(tuple(int(d) for d in dots[k]), place[k], float(cost[k]))
            found[pair.dots] = pair
            wider = _widen(cameras, pair, sizes)
            if wider is not None:
                found.setdefault(wider.dots, wider)
    return list(found.values())


def _widen(cameras: Sequence[DetectedDots], pair: _TrackCandidate, sizes: _NominalSizes) -> _TrackCandidate | None:
    """The candidate with the dots that other cameras have at its place; None if they have none that fits."""
    dots = list(pair.dots)
    for c, camera in enumerate(cameras):
        if dots[c] >= 0 or not len(camera.centres_px):
            continue
        expected = camera.view.project(pair.place_mm[None])[0]
        distance = np.hypot(*(camera.centres_px - expected).T)
        if np.isfinite(expected).all() and distance.min() < 20 * SD_PLACE_PX + 0.5 * camera.radius_px.mean():
            dots[c] = int(np.argmin(distance))
    if tuple(dots) == pair.dots:
        return None
    pixels = np.stack(
        [[cam.centres_px[d] if d >= 0 else (np.nan, np.nan)] for cam, d in zip(cameras, dots, strict=True)]
    )
    place = intersect_rays([camera.view for camera in cameras], pixels)
    cost = float(_cost(cameras, np.array([dots]), place, sizes)[0])
    allowed = GATE_COST * (sum(dot >= 0 for dot in dots) - 1)
    return _TrackCandidate(tuple(dots), place[0], cost) if cost < allowed else None


def _cost(
    cameras: Sequence[DetectedDots], dots: NDArray[np.intp], place: FloatArray, sizes: _NominalSizes
) -> FloatArray:
    """(n,) squared normalised discrepancies of rays and sizes; inf behind a camera."""
    total = np.zeros(len(dots))
    excess = np.full((len(dots), len(cameras)), np.nan)
    for c, camera in enumerate(cameras):
        rows = np.flatnonzero((dots[:, c] >= 0) & np.isfinite(place).all(axis=1))
        if not rows.size:
            continue
        pixels, _, by_exterior = camera.view.project_with_jacobians(place[rows])
        miss = camera.centres_px[dots[rows, c]] - pixels
        covariance = by_exterior @ camera.view.covariance @ by_exterior.swapaxes(1, 2) + SD_PLACE_PX**2 * np.eye(2)
        with np.errstate(invalid="ignore"):
            total[rows] += np.einsum("ni,ni->n", miss, np.linalg.solve(covariance, miss[..., None])[..., 0])
            depth = camera.view.to_camera_axes(place[rows])[:, 2]
            radius_mm = camera.radius_px[dots[rows, c]] * depth / np.mean(camera.view.lens.focal_px)
            excess[rows, c] = np.log(radius_mm)
    seen = np.isfinite(excess)
    number = seen.sum(axis=1)
    mean = np.where(number > 0, np.nansum(excess, axis=1) / np.maximum(number, 1), np.nan)
    spread = np.nansum((excess - mean[:, None]) ** 2, axis=1) / SD_RELATIVE_SIZE**2
    total = total + spread + sizes.cost(mean)
    complete = number == (dots >= 0).sum(axis=1)
    return np.where(complete & np.isfinite(total), total, np.inf)


def _conflict_clusters(
    candidates: list[_TrackCandidate], cameras: Sequence[DetectedDots]
) -> list[list[_TrackCandidate]]:
    """Candidates grouped so that only those of one group compete for dots."""
    if not candidates:
        return []
    offsets = np.concatenate([[0], np.cumsum([len(camera.centres_px) for camera in cameras])])
    rows, columns = _incidence(candidates, offsets)
    size = len(candidates) + int(offsets[-1])
    graph = coo_array((np.ones(len(rows)), (rows, columns + len(candidates))), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    groups: dict[int, list[_TrackCandidate]] = {}
    for candidate, cluster in zip(candidates, label[: len(candidates)], strict=True):
        groups.setdefault(int(cluster), []).append(candidate)
    return list(groups.values())


def _incidence(
    candidates: Sequence[_TrackCandidate], offsets: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    pairs = [(n, offsets[c] + dot) for n, cand in enumerate(candidates) for c, dot in enumerate(cand.dots) if dot >= 0]
    rows, columns = np.array(pairs).T
    return rows, columns


def _solve(cluster: list[_TrackCandidate]) -> list[Track]:
    """Choose candidates of one cluster; mark those that its second-best choice would replace at little cost."""
    if len(cluster) == 1:
        return [Track(cluster[0].dots, cluster[0].place_mm)]
    cameras = len(cluster[0].dots)
    offsets = np.arange(cameras) * (1 + max(max(candidate.dots) for candidate in cluster))
    rows, columns = _incidence(cluster, offsets)
    _, columns = np.unique(columns, return_inverse=True)
    uses = coo_array((np.ones(len(rows)), (columns, rows)), shape=(columns.max() + 1, len(cluster))).tocsr()
    gain = np.array([candidate.gain for candidate in cluster])

    def best(without: int | None) -> tuple[float, NDArray[np.bool_]]:
        upper = np.ones(len(cluster))
        if without is not None:
            upper[without] = 0.0
        result = milp(
            -gain,
            integrality=np.ones(len(cluster), dtype=np.int64),
            bounds=Bounds(0, upper),
            constraints=LinearConstraint(uses, ub=1),
        )
        if result.x is None or result.fun is None:  # the empty choice is always allowed, so this is a time limit
            return 0.0, np.zeros(len(cluster), dtype=np.bool_)
        return -float(result.fun), np.asarray(result.x > 0.5)

    total, chosen = best(None)
    tracks = []
    for index in np.flatnonzero(chosen):
        second, other = best(int(index))
        # A subset of the same dots (one camera fewer) is no rival: it says the same.
        rivals = [cluster[k] for k in np.flatnonzero(other)]
        same = any(_agree(cluster[index], rival) for rival in rivals)
        tracks.append(Track(cluster[index].dots, cluster[index].place_mm, same or total - second > CLEAR_COST))
    return tracks


def _agree(one: _TrackCandidate, other: _TrackCandidate) -> bool:
    shared = [a for a, b in zip(one.dots, other.dots, strict=True) if a == b and a >= 0]
    clash = any(a != b and a >= 0 and b >= 0 for a, b in zip(one.dots, other.dots, strict=True))
    return len(shared) >= 2 and not clash
