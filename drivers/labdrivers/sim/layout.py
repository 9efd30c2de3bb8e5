"""Measuring set-ups for rendered data-set folders: a field of targets, control targets around it, cameras before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from labdrivers.sim.lens import CameraModel
from labdrivers.sim.scene import Panel, Scene, SceneTag, SceneTarget

SIZES = {"small": ((1936, 1296), 12.2), "d80": ((3900, 2613), 6.1)}
"""Frame size and pixel pitch (µm): a D80's area, whole or binned by two."""

FOCAL_MM = 24.0
DISTORTION = (-0.09, 0.07, 0.0003, -0.0002, 0.0)
FIELD_X_MM, FIELD_Z_MM = 600.0, 470.0
MIDDLE_Z_MM = 365.0
CAMERA_NAMES = {1: ("front",), 2: ("left", "right"), 3: ("left", "right", "top")}


@dataclass(frozen=True, slots=True)
class SceneLayout:
    """A scene and the cameras before it.

    Attributes
    ----------
    scene
        What stands there.
    cameras
        By name.
    pitch_um
        Size of a pixel.
    """

    scene: Scene
    cameras: dict[str, CameraModel]
    pitch_um: float


def make_layout(
    *,
    seed: int,
    cameras: int,
    size: str,
    targets: int,
    diameters_mm: tuple[float, ...],
    paper_mm: float,
    texture: float,
    texture_length_mm: float,
    still_paper: bool,
    gradient: tuple[float, float],
    distance_mm: float,
) -> SceneLayout:
    """Place everything.

    With one camera all targets and control targets lie in the plane y = 0; with more they are spread in depth.

    Parameters
    ----------
    seed
        Of places, lenses and looks.
    cameras
        1, 2 or 3.
    size
        A key of `SIZES`.
    targets
        How many.
    diameters_mm
        Taken in turn.
    paper_mm
        Side of the white labels.
    texture, texture_length_mm, still_paper, gradient
        As in `Scene`.
    distance_mm
        From the cameras to the middle of the field.

    Raises
    ------
    ValueError
        If the labels do not fit side by side, or the number of cameras or the size is not offered.
    """
    if cameras not in CAMERA_NAMES:
        raise ValueError(f"cameras must be one of {sorted(CAMERA_NAMES)}, not {cameras}")
    if size not in SIZES:
        raise ValueError(f"size must be one of {sorted(SIZES)}, not {size!r}")
    rng = np.random.default_rng([seed, 41])
    scale = distance_mm / 1000.0
    columns = math.ceil(math.sqrt(targets * FIELD_X_MM / FIELD_Z_MM))
    rows = math.ceil(targets / columns)
    pitch_x, pitch_z = scale * FIELD_X_MM / columns, scale * FIELD_Z_MM / rows
    if min(pitch_x, pitch_z) < paper_mm + 3.0:
        room = f"{pitch_x:.0f} x {pitch_z:.0f} mm"
        raise ValueError(f"{targets} labels of {paper_mm:.0f} mm do not fit: each has {room}; fewer, or farther away")
    depth = np.zeros(columns) if cameras == 1 else rng.uniform(-60.0, 60.0, columns)
    dots: list[SceneTarget] = []
    for k in range(targets):
        row, column = divmod(k, columns)
        x = (column - 0.5 * (columns - 1)) * pitch_x
        z = MIDDLE_Z_MM + ((rows - 1) * 0.5 - row) * pitch_z
        name = f"{chr(ord('A') + row % 26)}{column:02d}"
        place = (round(x, 3), round(float(depth[column]), 3), round(z, 3))
        dots.append(SceneTarget(name, place, diameters_mm[k % len(diameters_mm)], (paper_mm, paper_mm)))
    across, up = scale * (0.5 * FIELD_X_MM + 85.0), scale * 0.5 * FIELD_Z_MM
    spots = [(-across, -0.9 * up), (-across, 0.0), (-across, 0.9 * up), (across, -0.9 * up), (across, 0.0)]
    spots.append((across, 0.9 * up))
    flat = cameras == 1
    tags = tuple(
        SceneTag(
            number,
            (
                round(x + float(rng.uniform(-4, 4)), 3),
                0.0 if flat else round(float((-70.0, 60.0, -40.0, 65.0, -60.0, 50.0)[number]), 3),
                round(MIDDLE_Z_MM + z + float(rng.uniform(-4, 4)), 3),
            ),
            36.0 * scale,
            56.0 * scale,
        )
        for number, (x, z) in enumerate(spots)
    )
    scene = Scene(
        tuple(dots),
        tags,
        _panels(scale, columns, pitch_x),
        texture=texture,
        texture_length_mm=texture_length_mm,
        still_paper=still_paper,
        gradient=gradient,
        seed=seed,
    )
    image_size, pixel_um = SIZES[size]
    places = {
        "front": (10.0, -distance_mm, MIDDLE_Z_MM + 12.0),
        "left": (-0.40 * distance_mm, -0.93 * distance_mm, MIDDLE_Z_MM + 40.0),
        "right": (0.42 * distance_mm, -0.92 * distance_mm, MIDDLE_Z_MM - 30.0),
        "top": (30.0, -0.88 * distance_mm, MIDDLE_Z_MM + 0.48 * distance_mm),
    }
    seen = {}
    for name in CAMERA_NAMES[cameras]:
        focal = FOCAL_MM * 1e3 / pixel_um * float(rng.uniform(0.99, 1.01))
        middle = rng.uniform(-8.0, 8.0, 2) + (np.array(image_size) - 1.0) / 2.0
        aim = (float(rng.uniform(-8, 8)), 0.0, MIDDLE_Z_MM + float(rng.uniform(-8, 8)))
        seen[name] = CameraModel.looking_at(
            aim,
            places[name],
            image_size=image_size,
            focal_px=(round(focal, 3), round(focal, 3)),
            principal_point_px=(round(float(middle[0]), 3), round(float(middle[1]), 3)),
            distortion=DISTORTION,
            roll_rad=float(rng.uniform(-0.02, 0.02)),
        )
    return SceneLayout(scene, seen, pixel_um)


def _panels(scale: float, columns: int, pitch_x: float) -> tuple[Panel, ...]:
    """A rack behind the labels, so that they hang on something."""
    half_z = scale * (0.5 * FIELD_Z_MM + 20.0)
    bars = []
    for column in range(columns):
        x = (column - 0.5 * (columns - 1)) * pitch_x
        low, high = MIDDLE_Z_MM - half_z, MIDDLE_Z_MM + half_z
        corners = ((x - 9.0, 70.0, low), (x + 9.0, 70.0, low), (x + 9.0, 70.0, high), (x - 9.0, 70.0, high))
        bars.append(Panel(corners, (0.33, 0.34, 0.35), moving=False))
    return tuple(bars)
