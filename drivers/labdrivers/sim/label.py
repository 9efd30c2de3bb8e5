"""Dots and control targets as the lens sees them, still or smeared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.lens import Camera, FloatArray, Shift
from labdrivers.sim.scene import Scene, Tag, Target
from labdrivers.sim.sensor import FloatImage
from labdrivers.sim.window import Window, dwell_map, transform

Plane = Callable[[FloatArray], FloatArray]
"""Points (n, 2) of a card's own plane, mm -> object points (n, 3)."""

SHAPE_STEP_PX = 0.04
"""A shape is drawn anew when its outline has changed by this much on the way (depth, perspective, distortion)."""

PAPER_STEP_PX = 0.3
"""The same for the label's paper, whose edges nobody measures."""

MAX_SHAPES = 32

STEP_PX = 0.05
"""Moments of the exposure lie no farther apart than this along the path."""

MIN_MOMENTS, MAX_MOMENTS = 512, 60_000


@dataclass(frozen=True, slots=True)
class View:
    """A camera as it stood for one frame."""

    camera: Camera
    shift: Shift

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Image points (n, 2) of object points (n, 3)."""
        return self.shift.apply(self.camera.project(points_mm), self.camera.image_size)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where something was at many equally long moments of the exposure.

    Attributes
    ----------
    times_s
        (n,) middles of the moments.
    displacement_mm
        (n, 3) from rest.
    """

    times_s: FloatArray
    displacement_mm: FloatArray


def moments(opened_s: float, exposure_s: float, count: int) -> FloatArray:
    """Middles of `count` equal parts of the exposure."""
    return opened_s + (np.arange(count) + 0.5) / count * exposure_s


def follow(
    view: View, rest_mm: FloatArray, motion: Callable[[FloatArray], FloatArray], window_s: tuple[float, float]
) -> Path:
    """Sample a motion so finely that its image moves less than `STEP_PX` from one moment to the next."""
    times = moments(*window_s, MIN_MOMENTS)
    displacement = np.asarray(motion(times), float)
    image = view.project(rest_mm + displacement)
    length = float(np.linalg.norm(np.diff(image, axis=0), axis=1).sum())
    # the first, coarse sampling may cut corners: hence the margin
    count = int(np.clip(1.5 * length / STEP_PX, MIN_MOMENTS, MAX_MOMENTS))
    if count > MIN_MOMENTS:
        times = moments(*window_s, count)
        displacement = np.asarray(motion(times), float)
    return Path(times, displacement)


def plane_coordinates(
    view: View, plane: Plane, half_mm: tuple[float, float], displacement_mm: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where on a card each image point lies: (rows, columns) of u and of v, mm, for image coordinates `x` and `y`.

    The lens is followed from the card to the image at a grid of points; the way back is a polynomial through them,
    exact to better than 1e-6 of the card's size since distortion hardly bends over so small a piece.
    """
    steps = np.linspace(-1.15, 1.15, 11)
    u, v = (grid.ravel() for grid in np.meshgrid(steps * half_mm[0], steps * half_mm[1]))
    image = view.project(plane(np.stack([u, v], axis=1)) + displacement_mm)
    middle, scale = image.mean(axis=0), np.ptp(image, axis=0) / 2.0
    order = 5
    px, py = ((image - middle) / scale).T
    terms = [(i, j) for j in range(order) for i in range(order - j)]
    basis = np.stack([px**i * py**j for i, j in terms], axis=1)
    solution = np.linalg.lstsq(basis, np.stack([u, v], axis=1))[0]
    grid_u, grid_v = np.zeros((order, order)), np.zeros((order, order))
    for (i, j), row in zip(terms, solution, strict=True):
        grid_u[j, i], grid_v[j, i] = row
    powers_x = ((x - middle[0]) / scale[0])[None, :] ** np.arange(order)[:, None]
    powers_y = ((y - middle[1]) / scale[1])[:, None] ** np.arange(order)[None, :]
    return powers_y @ grid_u @ powers_x, powers_y @ grid_v @ powers_x


def coverage(distance_mm: FloatArray, cell_mm: float) -> FloatArray:
    """Fraction of a fine cell inside an outline whose signed distance from the cell's centre is given (inside < 0)."""
    return np.clip(0.5 - distance_mm / cell_mm, 0.0, 1.0)


@lru_cache(maxsize=256)
def texture(seed: int, extent_mm: tuple[float, float], length_mm: float) -> tuple[FloatImage, float]:
    """A card's own grain: unit variance, Gaussian correlation exp(-r²/(2 length²)); and its cell, mm."""
    cell = length_mm / 3.0
    columns, rows = (int(np.ceil(side * 1.1 / cell)) for side in extent_mm)
    rng = np.random.default_rng([seed, 21])
    sigma = length_mm / np.sqrt(2.0) / cell
    grain = cv2.GaussianBlur(rng.standard_normal((rows, columns), dtype=np.float32), (0, 0), sigma)
    # white noise smoothed by a Gaussian of sigma cells keeps a variance of 1/(4 pi sigma²)
    return np.asarray(grain * np.float32(np.sqrt(4.0 * np.pi) * sigma)), cell


def grain_at(scene: Scene, card: int, extent_mm: tuple[float, float], u: FloatArray, v: FloatArray) -> FloatImage:
    """Relative deviation of a card's reflectance at its plane coordinates."""
    if scene.texture == 0.0:
        return np.zeros(u.shape, np.float32)
    image, cell = texture(scene.seed * 10_007 + card, extent_mm, scene.texture_length_mm)
    rows, columns = image.shape
    map_x = (u / cell + 0.5 * (columns - 1)).astype(np.float32)
    map_y = (0.5 * (rows - 1) - v / cell).astype(np.float32)
    drawn = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(drawn * np.float32(scene.texture))


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Part of a card in a window of its own.

    Attributes
    ----------
    window
        Where.
    spectra
        Of its fine images: for paper the light it sends and the time it hid what is behind; for ink the light it takes.
    """

    window: Window
    spectra: tuple[NDArray[np.complex64], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Smear:
    """A card with what is printed on it, added up over the exposure.

    The paper is drawn less finely than the ink: only the ink's edges are measured.
    """

    paper: Layer
    ink: Layer


def smear_target(scene: Scene, index: int, view: View, path: Path, fine: int) -> Smear | None:
    """A dot with its label, added up over the exposure; None if it stays outside the frame."""
    target = scene.targets[index]
    image = view.project(np.asarray(target.centre_mm) + path.displacement_mm)
    half = (0.5 * target.paper_mm[0], 0.5 * target.paper_mm[1])
    radius = 0.5 * target.diameter_mm
    paper_window = _window(view, target.points, half, path, image, max(fine // 2, 1))
    ink_window = _window(view, target.points, (radius, radius), path, image, fine)
    if not paper_window.meets(view.camera.image_size):
        return None
    if scene.still_paper:
        still = Path(path.times_s[:1], np.zeros((1, 3)))
        paper = _accumulate(draw_paper, scene, index, view, still, paper_window, PAPER_STEP_PX)
    else:
        paper = _accumulate(draw_paper, scene, index, view, path, paper_window, PAPER_STEP_PX)
    return Smear(paper, _accumulate(draw_ink, scene, index, view, path, ink_window, SHAPE_STEP_PX))


def _window(view: View, plane: Plane, half_mm: tuple[float, float], path: Path, image: FloatArray, fine: int) -> Window:
    """A window that a rectangle of the card never leaves."""
    corners = plane(np.array([(sx * half_mm[0], sy * half_mm[1]) for sx in (-1, 1) for sy in (-1, 1)]))
    turning = np.unique(np.concatenate([image.argmin(axis=0), image.argmax(axis=0), [0]]))
    outline = np.concatenate([view.project(corners + d) for d in path.displacement_mm[turning]])
    return Window.around(outline.min(axis=0) - 1.0, outline.max(axis=0) + 1.0, fine)


Draw = Callable[[Scene, int, View, FloatArray, Window], tuple[FloatImage, ...]]


def _accumulate(draw: Draw, scene: Scene, index: int, view: View, path: Path, window: Window, step_px: float) -> Layer:
    """Draw a shape once for every group of moments in which it looks the same, and spread it over their dwell times."""
    target = scene.targets[index]
    centre = np.asarray(target.centre_mm)
    image = view.project(centre + path.displacement_mm)
    total: list[NDArray[np.complex64]] = []
    for members in shape_groups(target, view, path, step_px):
        displacement = path.displacement_mm[members].mean(axis=0)
        place = view.project((centre + displacement)[None, :])[0]
        weight = np.full(members.size, 1.0 / path.times_s.size)
        dwell = transform(dwell_map(image[members] - place, weight, window))
        spectra = [transform(part) * dwell for part in draw(scene, index, view, displacement, window)]
        total = [one + other for one, other in zip(total, spectra, strict=True)] if total else spectra
    return Layer(window, tuple(total))


def shape_groups(target: Target, view: View, path: Path, step_px: float) -> list[NDArray[np.intp]]:
    """Moments sorted into groups in which the dot's outline looks the same to within `step_px`."""
    radius = 0.5 * target.diameter_mm
    rim = target.points(radius * np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]))
    every = max(1, path.times_s.size // 400)
    sample = path.displacement_mm[::every]
    centre = view.project(np.asarray(target.centre_mm) + sample)
    outline = np.concatenate([view.project(point + sample) - centre for point in rim], axis=1)
    deviation = outline - outline.mean(axis=0)
    # the outline changes linearly with displacement over so short a way
    away = sample - sample.mean(axis=0)
    if np.abs(deviation).max() < 0.5 * step_px:
        return [np.arange(path.times_s.size)]
    slope = np.linalg.lstsq(away, deviation)[0]
    direction = np.linalg.svd(slope, full_matrices=False)
    score = (path.displacement_mm - sample.mean(axis=0)) @ direction[0][:, 0] * direction[1][0]
    count = int(np.clip(np.ceil(np.ptp(score) / step_px), 1, MAX_SHAPES))
    edges = np.linspace(score.min(), score.max(), count + 1)[1:-1]
    group = np.searchsorted(edges, score)
    return [members for k in range(count) if (members := np.flatnonzero(group == k)).size]


def draw_paper(
    scene: Scene, index: int, view: View, displacement_mm: FloatArray, window: Window
) -> tuple[FloatImage, FloatImage]:
    """Fine images of a displaced label without its ink: the light it sends, and its coverage."""
    target = scene.targets[index]
    half = (0.5 * target.paper_mm[0], 0.5 * target.paper_mm[1])
    part, u, v = _card(view, target.points, half, displacement_mm, window)
    cell_u, cell_v = _cell(u, v)
    cover = coverage(np.abs(u) - half[0], cell_u) * coverage(np.abs(v) - half[1], cell_v)
    white = cover * scene.paper * (1.0 + grain_at(scene, index, target.paper_mm, u, v))
    return _placed(white, part, window), _placed(cover, part, window)


def draw_ink(scene: Scene, index: int, view: View, displacement_mm: FloatArray, window: Window) -> tuple[FloatImage]:
    """Fine image of the light that a displaced dot takes away from its label."""
    target = scene.targets[index]
    half = (0.5 * target.paper_mm[0], 0.5 * target.paper_mm[1])
    radius = 0.5 * target.diameter_mm
    part, u, v = _card(view, target.points, (radius, radius), displacement_mm, window)
    taken = disc_coverage(u, v, radius) * (scene.paper - scene.ink)
    taken *= (np.abs(u) < half[0]) & (np.abs(v) < half[1])
    taken *= 1.0 + grain_at(scene, index, target.paper_mm, u, v)
    return (_placed(taken, part, window),)


Part = tuple[slice, slice]


def _card(
    view: View, plane: Plane, half_mm: tuple[float, float], displacement_mm: FloatArray, window: Window
) -> tuple[Part, FloatArray, FloatArray]:
    """The rows and columns of a window that a rectangle of a card falls on, and the card's coordinates there."""
    x, y = window.centres()
    corners = np.array([(sx * half_mm[0], sy * half_mm[1]) for sx in (-1, 1) for sy in (-1, 1)])
    box = view.project(plane(corners) + displacement_mm)
    columns = slice(*np.searchsorted(x, (box[:, 0].min() - 1.0, box[:, 0].max() + 1.0)))
    rows = slice(*np.searchsorted(y, (box[:, 1].min() - 1.0, box[:, 1].max() + 1.0)))
    u, v = plane_coordinates(view, plane, half_mm, displacement_mm, x[columns], y[rows])
    return (rows, columns), u, v


def _placed(image: FloatArray, part: Part, window: Window) -> FloatImage:
    whole = np.zeros((window.height * window.fine, window.width * window.fine), np.float32)
    whole[part] = image
    return whole


def disc_coverage(u: FloatArray, v: FloatArray, radius_mm: float) -> FloatArray:
    """Fraction of each fine cell inside a circle of the card's plane.

    Within a cell the rim is taken as straight, and the part of the square on its inner side is exact: the distance
    from the rim over the cell is the sum of two uniform variables, one along each side.
    """
    radius = np.hypot(u, v)
    along_y, along_x = np.gradient(radius)
    inside = np.asarray(radius < radius_mm, float)
    rim = np.flatnonzero(np.abs(radius - radius_mm).ravel() < 2.0 * np.hypot(along_x, along_y).ravel())
    depth = radius_mm - radius.ravel()[rim]
    sides = np.abs(np.stack([along_x.ravel()[rim], along_y.ravel()[rim]]))
    # a side along the rim contributes nothing; keep the quotient finite
    long_side = sides.max(axis=0)
    short_side = np.maximum(sides.min(axis=0), 1e-4 * long_side)
    half_sum, half_difference = 0.5 * (long_side + short_side), 0.5 * (long_side - short_side)
    part = np.zeros_like(depth)
    for sign, corner in ((1, -half_sum), (-1, -half_difference), (-1, half_difference), (1, half_sum)):
        part += sign * np.clip(depth - corner, 0.0, None) ** 2
    inside.ravel()[rim] = part / (2.0 * long_side * short_side)
    return inside


def _cell(u: FloatArray, v: FloatArray) -> tuple[float, float]:
    """Millimetres that a fine cell spans along u and along v, in the middle of the card."""
    row, column = u.shape[0] // 2, u.shape[1] // 2
    du = np.hypot(u[row + 1, column] - u[row, column], u[row, column + 1] - u[row, column])
    dv = np.hypot(v[row + 1, column] - v[row, column], v[row, column + 1] - v[row, column])
    return float(du), float(dv)


@lru_cache(maxsize=64)
def tag_modules(number: int) -> NDArray[np.float64]:
    """(8, 8) ink (1) and paper (0) of a tag, its black border included, top row first."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, 8) < 128, float)


def smear_tag(scene: Scene, index: int, view: View, fine: int) -> Smear | None:
    """A control target, which does not move; None if it lies outside the frame."""
    tag: Tag = scene.tags[index]
    half = 0.5 * tag.card_mm
    still = Path(np.zeros(1), np.zeros((1, 3)))
    image = view.project(np.asarray(tag.centre_mm)[None, :])
    paper_window = _window(view, tag.points, (half, half), still, image, max(fine // 2, 1))
    if not paper_window.meets(view.camera.image_size):
        return None
    part, u, v = _card(view, tag.points, (half, half), np.zeros(3), paper_window)
    cell_u, cell_v = _cell(u, v)
    cover = coverage(np.abs(u) - half, cell_u) * coverage(np.abs(v) - half, cell_v)
    white = cover * scene.paper * (1.0 + grain_at(scene, 5000 + index, (tag.card_mm, tag.card_mm), u, v))
    spectra = [transform(_placed(image, part, paper_window)) for image in (white, cover)]
    square = (0.5 * tag.size_mm, 0.5 * tag.size_mm)
    ink_window = _window(view, tag.points, square, still, image, fine)
    part, u, v = _card(view, tag.points, square, np.zeros(3), ink_window)
    taken = tag_coverage(tag, u, v) * (scene.paper - scene.ink)
    taken *= 1.0 + grain_at(scene, 5000 + index, (tag.card_mm, tag.card_mm), u, v)
    ink = transform(_placed(taken, part, ink_window))
    return Smear(Layer(paper_window, tuple(spectra)), Layer(ink_window, (ink,)))


def tag_coverage(tag: Tag, u: FloatArray, v: FloatArray) -> FloatArray:
    """Fraction of each fine cell that is black."""
    cell_u, cell_v = _cell(u, v)
    module = tag.size_mm / 8.0
    modules = tag_modules(tag.number)
    ink = np.zeros_like(u)
    # each black module is a box; neighbours' edges add up to full coverage
    along_u = [coverage(np.abs(u - (k - 3.5) * module) - 0.5 * module, cell_u) for k in range(8)]
    along_v = [coverage(np.abs(v - (3.5 - k) * module) - 0.5 * module, cell_v) for k in range(8)]
    for row in range(8):
        across = sum((along_u[column] for column in range(8) if modules[row, column]), np.zeros_like(u))
        ink += along_v[row] * across
    return ink
