"""The rig file's lamp: checked against the trigger, and what planning with coded light needs of the rig."""

from __future__ import annotations

import math
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

from labdaemon.campaign.light_plan import ImageScale
from labdaemon.capture.lamp import Lamp

if TYPE_CHECKING:
    from labdaemon.service.config import RigConfig

UNKNOWN_IMAGE_SIZE = (6000, 4000)


def can_play(rig: RigConfig) -> bool:
    """Whether the trigger's driver can play a light code. Opens nothing."""
    driver = rig.trigger.driver
    found = entry_points(group="labdaemon.triggers")
    return driver in found.names and bool(getattr(found[driver].load(), "plays_light", False))


def lamp_of(rig: RigConfig) -> Lamp | None:
    """The rig's lamp; None without one, or where the trigger cannot play a code.

    A rig file serves with another trigger too, as while an outside system fires the shutters: only campaigns that ask
    for coded light are refused then.
    """
    section = rig.lamp
    if section is None or not can_play(rig):
        return None
    flicker_hz = None if section.mains_hz is None else 2.0 * section.mains_hz
    return Lamp(section.rise_s, section.ambient, section.levels, section.margin_s, flicker_hz, section.sd_ambient)


def image_scale(rig: RigConfig) -> ImageScale:
    """How large things are in the images before there is any: by each camera's distance, or as the survey fills them.

    The control targets are taken to lie within the middle five sixths of the frame's width and height.
    """
    from labdaemon.processing import read_control

    points = read_control(rig.path(rig.control.file), rig.control.size_mm)
    wide = max(math.hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm) for one in points for other in points)
    high = max(point.z_mm for point in points) - min(point.z_mm for point in points)
    scales: list[float] = []
    for camera in rig.cameras.values():
        width, height = camera.image_size or UNKNOWN_IMAGE_SIZE
        if camera.distance_mm is not None and camera.focal_px is not None:
            scales.append(camera.focal_px[0] / camera.distance_mm)
        elif wide > 0:
            scales.append(min(width / wide, height / high if high > 0 else math.inf) * 5 / 6)
    sizes = rig.targets.diameter_mm
    dot_mm = min(sizes) if isinstance(sizes, tuple) else sizes
    return ImageScale(min(scales), dot_mm) if scales else ImageScale(dot_mm=dot_mm)
