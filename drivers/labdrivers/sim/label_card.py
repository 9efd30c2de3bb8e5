"""Cards as drawn on a fine grid: where the lens puts them, and what part of each cell paper, dot and tag cover."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.lens import FloatArray
from labdrivers.sim.path import CameraView
from labdrivers.sim.scene import Scene, SceneTag
from labdrivers.sim.sensor import FloatImage
from labdrivers.sim.window import PixelWindow

Plane = Callable[[FloatArray], FloatArray]
"""Points (n, 2) of a card's own plane, mm -> object points (n, 3)."""


def plane_coordinates(
    view: CameraView,
    plane: Plane,
    half_mm: tuple[float, float],
    displacement_mm: FloatArray,
    x: FloatArray,
    y: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Where on a card each image point lies: (rows, columns) of u and of v, mm, for image coordinates `x` and `y`.

    The lens is followed from the card to the image at a grid of points; the way back is a polynomial through them,
    exact to better than 1e-6 of the card's size since distortion is nearly linear over so small a piece.
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


def disc_coverage(u: FloatArray, v: FloatArray, radius_mm: float) -> FloatArray:
    """Fraction of each fine cell inside a circle of the card's plane.

    Within a cell the rim is taken as straight, and the part of the square on its inner side is exact: the distance
    from the rim over the cell is the sum of two uniform variables, one along each side. How much less a bent rim leaves
    inside, s²/(24 R) on average for a cell of side s, is taken off.
    """
    radius = np.hypot(u, v)
    along_y, along_x = np.gradient(radius)
    inside = np.asarray(radius < radius_mm, float)
    rim = np.flatnonzero(np.abs(radius - radius_mm).ravel() < 2.0 * np.hypot(along_x, along_y).ravel())
    sides = np.abs(np.stack([along_x.ravel()[rim], along_y.ravel()[rim]]))
    depth = radius_mm - radius.ravel()[rim] - (sides**2).sum(axis=0) / (24.0 * radius_mm)
    # a side along the rim contributes nothing; keep the quotient finite
    long_side = sides.max(axis=0)
    short_side = np.maximum(sides.min(axis=0), 1e-4 * long_side)
    half_sum, half_difference = 0.5 * (long_side + short_side), 0.5 * (long_side - short_side)
    part = np.zeros_like(depth)
    for sign, corner in ((1, -half_sum), (-1, -half_difference), (-1, half_difference), (1, half_sum)):
        part += sign * np.clip(depth - corner, 0.0, None) ** 2
    inside.ravel()[rim] = part / (2.0 * long_side * short_side)
    return inside


def cell_size(u: FloatArray, v: FloatArray) -> tuple[float, float]:
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


def tag_coverage(tag: SceneTag, u: FloatArray, v: FloatArray) -> FloatArray:
    """Fraction of each fine cell that is black."""
    cell_u, cell_v = cell_size(u, v)
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


@lru_cache(maxsize=256)
def texture(seed: int, extent_mm: tuple[float, float], length_mm: float) -> tuple[FloatImage, float]:
    """A card's paper texture noise: unit variance, Gaussian correlation exp(-r²/(2 length²)); and its cell, mm."""
    cell = length_mm / 3.0
    columns, rows = (int(np.ceil(side * 1.1 / cell)) for side in extent_mm)
    rng = np.random.default_rng([seed, 21])
    sigma = length_mm / np.sqrt(2.0) / cell
    noise = cv2.GaussianBlur(rng.standard_normal((rows, columns), dtype=np.float32), (0, 0), sigma)
    # white noise smoothed by a Gaussian of sigma cells keeps a variance of 1/(4 pi sigma²)
    return np.asarray(noise * np.float32(np.sqrt(4.0 * np.pi) * sigma)), cell


def grain_at(scene: Scene, card: int, extent_mm: tuple[float, float], u: FloatArray, v: FloatArray) -> FloatImage:
    """Relative difference of a card's reflectance from its mean, at its plane coordinates."""
    if scene.texture == 0.0:
        return np.zeros(u.shape, np.float32)
    image, cell = texture(scene.seed * 10_007 + card, extent_mm, scene.texture_length_mm)
    rows, columns = image.shape
    map_x = (u / cell + 0.5 * (columns - 1)).astype(np.float32)
    map_y = (0.5 * (rows - 1) - v / cell).astype(np.float32)
    drawn = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(drawn * np.float32(scene.texture))


def draw_paper(
    scene: Scene, index: int, view: CameraView, displacement_mm: FloatArray, window: PixelWindow
) -> tuple[FloatImage, FloatImage]:
    """Fine images of a displaced label without its ink: the light it sends, and its coverage."""
    target = scene.targets[index]
    half = (0.5 * target.paper_mm[0], 0.5 * target.paper_mm[1])
    part, u, v = card_part(view, target.points, half, displacement_mm, window)
    cell_u, cell_v = cell_size(u, v)
    cover = coverage(np.abs(u) - half[0], cell_u) * coverage(np.abs(v) - half[1], cell_v)
    white = cover * scene.paper * (1.0 + grain_at(scene, index, target.paper_mm, u, v))
    return placed(white, part, window), placed(cover, part, window)


def draw_ink(
    scene: Scene, index: int, view: CameraView, displacement_mm: FloatArray, window: PixelWindow
) -> tuple[FloatImage]:
    """Fine image of the light that a displaced dot takes away from its label."""
    target = scene.targets[index]
    half = (0.5 * target.paper_mm[0], 0.5 * target.paper_mm[1])
    radius = 0.5 * target.diameter_mm
    part, u, v = card_part(view, target.points, (radius, radius), displacement_mm, window)
    taken = disc_coverage(u, v, radius) * (scene.paper - scene.ink)
    taken *= (np.abs(u) < half[0]) & (np.abs(v) < half[1])
    taken *= 1.0 + grain_at(scene, index, target.paper_mm, u, v)
    return (placed(taken, part, window),)


Part = tuple[slice, slice]


def card_part(
    view: CameraView, plane: Plane, half_mm: tuple[float, float], displacement_mm: FloatArray, window: PixelWindow
) -> tuple[Part, FloatArray, FloatArray]:
    """The rows and columns of a window that a rectangle of a card falls on, and the card's coordinates there."""
    x, y = window.centres()
    corners = np.array([(sx * half_mm[0], sy * half_mm[1]) for sx in (-1, 1) for sy in (-1, 1)])
    box = view.project(plane(corners) + displacement_mm)
    columns = slice(*np.searchsorted(x, (box[:, 0].min() - 1.0, box[:, 0].max() + 1.0)))
    rows = slice(*np.searchsorted(y, (box[:, 1].min() - 1.0, box[:, 1].max() + 1.0)))
    u, v = plane_coordinates(view, plane, half_mm, displacement_mm, x[columns], y[rows])
    return (rows, columns), u, v


def placed(image: FloatArray, part: Part, window: PixelWindow) -> FloatImage:
    whole = np.zeros((window.height * window.fine, window.width * window.fine), np.float32)
    whole[part] = image
    return whole
