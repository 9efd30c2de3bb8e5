"""Renders a frame as a camera would have taken it: from the motion itself, over the shutter's own window.

Nothing here is shared with the measurement: no law of dwell times is assumed for any motion. Each dot is drawn by the
area that it covers and added up over thousands of moments, each sent through the lens (see `card`, `smear`,
`window`); then come diffraction for each colour, the light, the mosaic, and the noise (see `optics`, `sensor`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from labdrivers.sim.background import HALF, backdrop
from labdrivers.sim.lens import CameraModel, FloatArray, SensorShift
from labdrivers.sim.optics import Optics
from labdrivers.sim.path import MAX_MOMENTS, CameraView, MotionPath, follow, moments
from labdrivers.sim.scene import Mosaic, Occluder, Scene, TargetTruth
from labdrivers.sim.sensor import FloatImage, Sensor
from labdrivers.sim.smear import CardSpectra, blur_tag, blur_target
from labdrivers.sim.window import FINE, PixelWindow, develop

Motion = Callable[[FloatArray], FloatArray]
"""Ascending times (n,) s -> displacement (n, 3) mm from rest."""


@dataclass(frozen=True, slots=True, eq=False)
class RenderedFrame:
    """A frame and what really happened in it.

    Attributes
    ----------
    mosaic
        (h, w) uint16 as read out.
    truth
        By target's name.
    mean_dn
        (h, w) float32 expected DN above black, before fixed pattern, noise and clipping.
    """

    mosaic: Mosaic
    truth: dict[str, TargetTruth]
    mean_dn: FloatImage


def render_frame(
    scene: Scene | dict[str, Any],
    camera: CameraModel | dict[str, Any],
    *,
    motions: Mapping[str, Motion] | None = None,
    panel_motion: Motion | None = None,
    brightness: Callable[[FloatArray], FloatArray] | None = None,
    opened_s: float = 0.0,
    exposure_s: float = 1.0,
    frequency_hz: float | None = None,
    phase_rad: float = 0.0,
    white_dn: float = 2900.0,
    shift: SensorShift | tuple[float, float, float] | None = None,
    optics: Optics | dict[str, Any] | None = None,
    sensor: Sensor | dict[str, Any] | None = None,
    occluders: tuple[Occluder, ...] = (),
    seed: int = 0,
    fine: int = FINE,
) -> RenderedFrame:
    """Expose one frame.

    Every argument that is a class of this package may also be a plain mapping of its attributes.

    Parameters
    ----------
    scene
        What stands before the camera.
    camera
        Where it stands, and its lens.
    motions
        By target's name: displacement over time. Who is not named stays at rest.
    panel_motion
        Displacement (corners, n, 3) of the panels' corners at times (n,), for the looks of it.
    brightness
        All light (n,) at times (n,), in parts of the light at which `white_dn` holds; None for constant light.
    opened_s, exposure_s
        The shutter's window, on the motions' clock.
    frequency_hz, phase_rad
        Excitation and its phase at the opening: only for the truth's a and b.
    white_dn
        What white paper of reflectance `scene.paper` reads above black in the middle of the frame, in green.
    shift
        How the frame sits against the camera's surveyed place: x px, y px, roll rad.
    optics, sensor
        Lens blur; mosaic and noise.
    occluders
        Things in front of everything.
    seed
        Of this frame's noise.
    fine
        Cells along a pixel's side in which coverage is sampled.

    Returns
    -------
    RenderedFrame
        The mosaic and each target's truth.
    """
    scene = Scene.of(scene)
    camera = camera if isinstance(camera, CameraModel) else CameraModel(**camera)
    shift = shift if isinstance(shift, SensorShift) else SensorShift(*(shift or ()))
    optics = optics if isinstance(optics, Optics) else Optics(**(optics or {}))
    sensor = sensor if isinstance(sensor, Sensor) else Sensor(**(sensor or {}))
    view = CameraView(camera, shift)
    window_s = (opened_s, exposure_s)
    planes = _planes(backdrop(scene, view, panel_motion, window_s, 1.2), sensor, camera.image_size)
    for index in range(len(scene.tags)):
        _composite(planes, _still_tag(scene, index, view, fine, optics), sensor)
    truth: dict[str, TargetTruth] = {}
    for index, target in enumerate(scene.targets):
        motion = (motions or {}).get(target.name)
        rest = np.asarray(target.centre_mm, float)
        path = (
            follow(view, rest, motion, window_s, brightness)
            if motion is not None
            else MotionPath.at_rest(opened_s + 0.5 * exposure_s)
        )
        truth[target.name] = _truth(target.name, rest, view, path, opened_s, frequency_hz, phase_rad)
        smear = blur_target(scene, index, view, path, fine)
        _composite(planes, None if smear is None else _image_card(smear, optics), sensor)
    mean_dn = _interleave(planes, camera.image_size)
    for occluder in occluders:
        _occlude(mean_dn, occluder)
    mean_dn *= _light(scene.gradient, scene.vignetting, camera.image_size)
    mean_dn *= np.float32(white_dn / scene.paper * _mean_light(brightness, opened_s, exposure_s))
    _colour(mean_dn, sensor)
    return RenderedFrame(sensor.expose(mean_dn, seed), truth, mean_dn)


def _mean_light(brightness: Callable[[FloatArray], FloatArray] | None, opened_s: float, exposure_s: float) -> float:
    """Mean light over the exposure, 1 for constant light."""
    if brightness is None:
        return 1.0
    return float(np.mean(brightness(moments(opened_s, exposure_s, MAX_MOMENTS))))


Planes = dict[tuple[int, int], FloatImage]
"""The four sites of a 2 × 2 mosaic: (row, column) -> every second pixel from there."""


def _planes(reflectance: FloatImage, sensor: Sensor, image_size: tuple[int, int]) -> Planes:
    width, height = image_size
    planes: Planes = {}
    for row in range(HALF):
        for column in range(HALF):
            rows, columns = (height - row + 1) // HALF, (width - column + 1) // HALF
            planes[row, column] = np.ascontiguousarray(reflectance[:rows, :columns, sensor.colour(row, column)])
    return planes


@lru_cache(maxsize=512)
def _still_tag(scene: Scene, index: int, view: CameraView, fine: int, optics: Optics) -> CardImages | None:
    """Control targets do not move: they look the same in every frame of a camera that stands still."""
    smear = blur_tag(scene, index, view, fine)
    return None if smear is None else _image_card(smear, optics)


@dataclass(frozen=True, slots=True, eq=False)
class CardImages:
    """A card seen through the lens: images of each colour in their windows."""

    paper_window: PixelWindow
    white: list[FloatImage]
    cover: list[FloatImage]
    ink_window: PixelWindow
    taken: list[FloatImage]


def _image_card(smear: CardSpectra, optics: Optics) -> CardImages:
    paper, ink = smear.paper, smear.ink
    white, cover = develop(paper.spectra, paper.window, optics)
    (taken,) = develop(ink.spectra, ink.window, optics)
    return CardImages(paper.window, white, cover, ink.window, taken)


def _composite(planes: Planes, card: CardImages | None, sensor: Sensor) -> None:
    """Put a card in front of what is there: its own light, and the rest dimmed by the time it was hidden."""
    if card is None:
        return
    for site, plane in planes.items():
        colour = sensor.colour(*site)
        where, mine = _overlap(plane, site, card.paper_window)
        if where is not None:
            cover, white = card.cover[colour][mine], card.white[colour][mine]
            behind = plane[where]
            hidden = np.clip(cover, 0.0, 1.0)
            # Behind the card only the far skirts of the lens's blur bring light, and those carry no detail.
            soft = cv2.GaussianBlur(behind, (0, 0), 6.0)
            mixed = behind + (soft - behind) * hidden
            plane[where] = mixed * (1.0 - cover) + white
        where, mine = _overlap(plane, site, card.ink_window)
        if where is not None:
            plane[where] -= card.taken[colour][mine]


Part = tuple[slice, slice]


def _overlap(plane: FloatImage, site: tuple[int, int], window: PixelWindow) -> tuple[Part | None, Part]:
    """Which part of a site's plane a window covers, and which of the window's pixels lie there."""
    whole: list[slice] = []
    mine: list[slice] = []
    for offset, start, length, size in zip(
        site, (window.y0, window.x0), (window.height, window.width), plane.shape, strict=True
    ):
        first = max(-(-(start - offset) // HALF), 0)
        last = min((start + length - 1 - offset) // HALF, size - 1)
        whole.append(slice(first, last + 1))
        mine.append(slice(first * HALF + offset - start, last * HALF + offset - start + 1, HALF))
        if last < first:
            return None, (slice(0), slice(0))
    return (whole[0], whole[1]), (mine[0], mine[1])


def _interleave(planes: Planes, image_size: tuple[int, int]) -> FloatImage:
    width, height = image_size
    image = np.empty((height, width), np.float32)
    for (row, column), plane in planes.items():
        image[row::HALF, column::HALF] = plane
    return image


@lru_cache(maxsize=2)
def _light(gradient: tuple[float, float], vignetting: float, image_size: tuple[int, int]) -> FloatImage:
    """Relative illumination (h, w): a gradient and the lens's vignetting, 1 in the middle."""
    width, height = image_size
    x = np.linspace(-1.0, 1.0, width, dtype=np.float32)[None, :]
    y = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, None]
    half = np.float32(0.5)
    light = half * np.float32(gradient[0]) * x + (half * np.float32(gradient[1]) * y + np.float32(1.0))
    light *= (np.float32(1.0) - half * np.float32(vignetting) * x * x) - half * np.float32(vignetting) * y * y
    light.flags.writeable = False
    return np.asarray(light)


def _colour(mean_dn: FloatImage, sensor: Sensor) -> None:
    for row in range(HALF):
        for column in range(HALF):
            mean_dn[row::HALF, column::HALF] *= np.float32(sensor.gain(sensor.colour(row, column)))


def _occlude(image: FloatImage, occluder: Occluder) -> None:
    mask = np.zeros(image.shape, np.uint8)
    corners = np.rint(np.asarray(occluder.polygon_px) * 16).astype(np.int32)
    cv2.fillPoly(mask, [corners], 255, cv2.LINE_AA, 4)
    veil = cv2.GaussianBlur(mask.astype(np.float32) / 255.0, (0, 0), occluder.softness_px)
    image += (np.float32(occluder.reflectance) - image) * veil


def _truth(
    name: str,
    rest_mm: FloatArray,
    view: CameraView,
    path: MotionPath,
    opened_s: float,
    frequency_hz: float | None,
    phase_rad: float,
) -> TargetTruth:
    image = view.project(rest_mm + path.displacement_mm)
    mean_px = path.weight @ image
    away = image - mean_px
    moment = (path.weight * away.T) @ away
    mean_mm = rest_mm + path.weight @ path.displacement_mm
    if frequency_hz is None or path.times_s.size == 1:
        return TargetTruth(name, mean_mm, mean_px, moment_px2=moment)
    angle = phase_rad + 2.0 * np.pi * frequency_hz * (path.times_s - opened_s)
    design = np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1)
    fitted = np.linalg.lstsq(design, np.concatenate([path.displacement_mm, image], axis=1))[0]
    return TargetTruth(
        name,
        mean_mm,
        mean_px,
        a_mm=fitted[1, :3],
        b_mm=fitted[2, :3],
        a_px=fitted[1, 3:],
        b_px=fitted[2, 3:],
        moment_px2=moment,
    )
