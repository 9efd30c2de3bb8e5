"""Dots and control targets, static or blurred: drawings added up over the moments of an exposure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.label_card import (
    Plane,
    card_part,
    cell_size,
    coverage,
    draw_ink,
    draw_paper,
    grain_at,
    placed,
    tag_coverage,
)
from labdrivers.sim.lens import FloatArray
from labdrivers.sim.path import CameraView, MotionPath
from labdrivers.sim.scene import Scene, SceneTag, SceneTarget
from labdrivers.sim.sensor import FloatImage
from labdrivers.sim.window import PixelWindow, dwell_map, transform

SHAPE_STEP_PX = 0.04
"""A shape is drawn anew when its outline has changed by this much on the way (depth, perspective, distortion)."""

PAPER_STEP_PX = 0.3
"""The same for the label's paper, whose edges are not measured."""

MAX_SHAPES = 32


@dataclass(frozen=True, slots=True, eq=False)
class CardLayer:
    """Part of a card in a window of its own.

    Attributes
    ----------
    window
        Where.
    spectra
        Of its fine images: for paper the light it sends and the time it hid what is behind; for ink the light it takes.
    """

    window: PixelWindow
    spectra: tuple[NDArray[np.complex64], ...]


@dataclass(frozen=True, slots=True, eq=False)
class CardSpectra:
    """Spectra of a card and of what is printed on it, added up over the exposure.

    The paper is drawn less finely than the ink: only the ink's edges are measured.
    """

    paper: CardLayer
    ink: CardLayer


def blur_target(scene: Scene, index: int, view: CameraView, path: MotionPath, fine: int) -> CardSpectra | None:
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
        still = MotionPath.at_rest(float(path.times_s[0]))
        paper = _accumulate(draw_paper, scene, index, view, still, paper_window, PAPER_STEP_PX)
    else:
        paper = _accumulate(draw_paper, scene, index, view, path, paper_window, PAPER_STEP_PX)
    return CardSpectra(paper, _accumulate(draw_ink, scene, index, view, path, ink_window, SHAPE_STEP_PX))


def _window(
    view: CameraView, plane: Plane, half_mm: tuple[float, float], path: MotionPath, image: FloatArray, fine: int
) -> PixelWindow:
    """A window that a rectangle of the card never leaves."""
    corners = plane(np.array([(sx * half_mm[0], sy * half_mm[1]) for sx in (-1, 1) for sy in (-1, 1)]))
    turning = np.unique(np.concatenate([image.argmin(axis=0), image.argmax(axis=0), [0]]))
    outline = np.concatenate([view.project(corners + d) for d in path.displacement_mm[turning]])
    return PixelWindow.around(outline.min(axis=0) - 1.0, outline.max(axis=0) + 1.0, fine)


Draw = Callable[[Scene, int, CameraView, FloatArray, PixelWindow], tuple[FloatImage, ...]]


def _accumulate(
    draw: Draw, scene: Scene, index: int, view: CameraView, path: MotionPath, window: PixelWindow, step_px: float
) -> CardLayer:
    """Draw a shape once for every group of moments in which it looks the same, and spread it over their dwell times."""
    target = scene.targets[index]
    centre = np.asarray(target.centre_mm)
    image = view.project(centre + path.displacement_mm)
    total: list[NDArray[np.complex64]] = []
    for members in shape_groups(target, view, path, step_px):
        weight = path.weight[members]
        displacement = np.average(path.displacement_mm[members], axis=0, weights=weight)
        place = view.project((centre + displacement)[None, :])[0]
        dwell = transform(dwell_map(image[members] - place, weight, window))
        spectra = [transform(part) * dwell for part in draw(scene, index, view, displacement, window)]
        total = [one + other for one, other in zip(total, spectra, strict=True)] if total else spectra
    return CardLayer(window, tuple(total))


def shape_groups(target: SceneTarget, view: CameraView, path: MotionPath, step_px: float) -> list[NDArray[np.intp]]:
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


def blur_tag(scene: Scene, index: int, view: CameraView, fine: int) -> CardSpectra | None:
    """A control target, which does not move; None if it lies outside the frame."""
    tag: SceneTag = scene.tags[index]
    half = 0.5 * tag.card_mm
    still = MotionPath.at_rest(0.0)
    image = view.project(np.asarray(tag.centre_mm)[None, :])
    paper_window = _window(view, tag.points, (half, half), still, image, max(fine // 2, 1))
    if not paper_window.meets(view.camera.image_size):
        return None
    part, u, v = card_part(view, tag.points, (half, half), np.zeros(3), paper_window)
    cell_u, cell_v = cell_size(u, v)
    cover = coverage(np.abs(u) - half, cell_u) * coverage(np.abs(v) - half, cell_v)
    white = cover * scene.paper * (1.0 + grain_at(scene, 5000 + index, (tag.card_mm, tag.card_mm), u, v))
    spectra = [transform(placed(image, part, paper_window)) for image in (white, cover)]
    square = (0.5 * tag.size_mm, 0.5 * tag.size_mm)
    ink_window = _window(view, tag.points, square, still, image, fine)
    part, u, v = card_part(view, tag.points, square, np.zeros(3), ink_window)
    taken = tag_coverage(tag, u, v) * (scene.paper - scene.ink)
    taken *= 1.0 + grain_at(scene, 5000 + index, (tag.card_mm, tag.card_mm), u, v)
    ink = transform(placed(taken, part, ink_window))
    return CardSpectra(CardLayer(paper_window, tuple(spectra)), CardLayer(ink_window, (ink,)))
