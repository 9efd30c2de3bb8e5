"""The rig file's lamp: checked against the trigger, and what planning with coded light needs of the rig."""

from __future__ import annotations

import math
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

from labdaemon.campaign.light_plan import ImageScale
from labdaemon.capture.lamp import Lamp
from labdaemon.errors import ConfigError

if TYPE_CHECKING:
    from labdaemon.service.config import RigConfig

UNKNOWN_IMAGE_SIZE = (6000, 4000)


def check_player(rig: RigConfig) -> None:
    """Check that the trigger's driver can play a code, where the rig has a lamp. Opens nothing.

    Raises
    ------
    ConfigError
        It cannot.
    """
    if rig.lamp is None:
        return
    driver = rig.trigger.driver
    found = entry_points(group="labdaemon.triggers")
    if driver in found.names and bool(getattr(found[driver].load(), "plays_light", False)):
        return
    why = "an outside system fires the shutters" if driver == "camera" else f"driver {driver} has no lamp output"
    raise ConfigError(
        f"no light code can be played: {why}; it takes a trigger with a lamp output, as driver box",
        source=rig.source,
        key="lamp.output",
    )


def lamp_of(rig: RigConfig) -> Lamp | None:
    """The rig's lamp, None without one."""
    section = rig.lamp
    if section is None:
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
