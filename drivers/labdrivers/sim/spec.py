"""The simulated laboratory in numbers: what `config/sim.toml` and `control.csv` mirror."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from labdrivers.sim.lens import CameraModel
from labdrivers.sim.scene import Panel, Scene, SceneTag, SceneTarget
from labdrivers.sim.sensor import Sensor
from labdrivers.sim.structure import DEFAULT_MODES, HEIGHT_MM, VibrationMode
from labdrivers.sim.table import TableSpec

COLUMN_X_MM = 150.0
FRONT_Y_MM = -100.0


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """A D80 with a 24 mm lens on a tripod.

    Attributes
    ----------
    serial
        On its USB descriptor and in its files.
    position_mm, aim_mm
        Where it stands and what it looks at.
    opening_lag_s
        From the release at the cable to the open shutter; bodies differ.
    """

    serial: str
    position_mm: tuple[float, float, float]
    aim_mm: tuple[float, float, float] = (0.0, FRONT_Y_MM, 385.0)
    image_size: tuple[int, int] = (3900, 2613)
    focal_px: tuple[float, float] = (3937.7, 3937.7)
    principal_point_px: tuple[float, float] = (1956.8, 1296.2)
    distortion: tuple[float, float, float, float, float] = (-0.09, 0.07, 0.0003, -0.0002, 0.0)
    opening_lag_s: float = 0.062

    def camera(self) -> CameraModel:
        """Lens and place, for the renderer."""
        return CameraModel.looking_at(
            self.aim_mm,
            self.position_mm,
            image_size=self.image_size,
            focal_px=self.focal_px,
            principal_point_px=self.principal_point_px,
            distortion=self.distortion,
        )


@dataclass(frozen=True, slots=True)
class LampSpec:
    """The lamp that lights the structure, on the trigger box's output.

    Attributes
    ----------
    rise_s
        Time from dark to full brightness and back.
    ambient
        Other light in the room, in parts of the lamp's full brightness.
    levels
        How many levels the output can show; 2 where it only switches.
    is_wired
        False for a lamp that is on whatever the output does.
    """

    rise_s: float = 1e-4
    ambient: float = 0.05
    levels: int = 256
    is_wired: bool = True


def frame_targets(dots_per_column: int = 12, diameter_mm: float = 8.0) -> tuple[SceneTarget, ...]:
    """Dots on the two front columns, from the table upwards: L01 (left, lowest) to R12 (right, top)."""
    heights = np.linspace(45.0, HEIGHT_MM - 25.0, dots_per_column)
    pitch = float(heights[1] - heights[0]) if dots_per_column > 1 else 60.0
    side = min(48.0, pitch - 4.0)
    return tuple(
        SceneTarget(f"{label}{index + 1:02d}", (x, FRONT_Y_MM, round(float(z), 3)), diameter_mm, (46.0, side))
        for label, x in (("L", -COLUMN_X_MM), ("R", COLUMN_X_MM))
        for index, z in enumerate(heights)
    )


def frame_panels() -> tuple[Panel, ...]:
    """The frame as the cameras see it, far members first: columns, floors, and the table below."""
    grey, dark = (0.42, 0.43, 0.45), (0.16, 0.17, 0.18)

    def upright(x: float, y: float, half: float, colour: tuple[float, float, float]) -> Panel:
        corners = ((x - half, y, 0.0), (x + half, y, 0.0), (x + half, y, HEIGHT_MM), (x - half, y, HEIGHT_MM))
        return Panel(corners, colour)

    def slab(z: float, y: float, colour: tuple[float, float, float]) -> Panel:
        wide = COLUMN_X_MM + 30.0
        return Panel(((-wide, y, z - 7.0), (wide, y, z - 7.0), (wide, y, z + 7.0), (-wide, y, z + 7.0)), colour)

    def top(z: float) -> Panel:
        wide, back = COLUMN_X_MM + 30.0, -FRONT_Y_MM
        corners = ((-wide, FRONT_Y_MM, z), (wide, FRONT_Y_MM, z), (wide, back, z), (-wide, back, z))
        return Panel(corners, (0.36, 0.37, 0.38))

    floors = [HEIGHT_MM * storey / 4.0 for storey in (1, 2, 3, 4)]
    bed = 227.5
    table = Panel(((-bed, -bed, -40.0), (bed, -bed, -40.0), (bed, -bed, 0.0), (-bed, -bed, 0.0)), dark)
    bed_top = Panel(((-bed, -bed, 0.0), (bed, -bed, 0.0), (bed, bed, 0.0), (-bed, bed, 0.0)), (0.22, 0.22, 0.23))
    rear = [upright(x, -FRONT_Y_MM, 20.0, (0.30, 0.31, 0.33)) for x in (-COLUMN_X_MM, COLUMN_X_MM)]
    front = [upright(x, FRONT_Y_MM + 2.0, 25.0, grey) for x in (-COLUMN_X_MM, COLUMN_X_MM)]
    slabs = [slab(z, FRONT_Y_MM + 3.0, (0.38, 0.39, 0.40)) for z in floors]
    return (bed_top, table, *rear, *(top(z) for z in floors), *slabs, *front)


def control_tags() -> tuple[SceneTag, ...]:
    """Control targets on stands around the table, spread in depth so that they fix both cameras."""
    places = [
        (-330.0, -60.0, 90.0), (-350.0, 60.0, 330.0), (-320.0, -140.0, 560.0), (-300.0, 40.0, 745.0),
        (330.0, -90.0, 110.0), (345.0, 50.0, 350.0), (325.0, -120.0, 585.0), (300.0, 30.0, 735.0),
        (10.0, 30.0, 95.0), (-10.0, 60.0, 470.0),
    ]  # fmt: skip
    return tuple(SceneTag(number, place) for number, place in enumerate(places))


@dataclass(frozen=True)
class RigSpec:
    """The whole simulated rig. The same spec and seed are the same lab, to the texture of its paper.

    Attributes
    ----------
    cameras
        By name.
    survey_sd_mm
        Standard deviation of the surveyed control centres in `control_csv`.
    iso, f_number
        The exposure at which `white_at` holds.
    white_dn
        What white paper in the middle of the frame reads (DN above black, green) in one second at that setting.
    at_s
        Exposure time of `white_dn`.
    lamp
        The lamp; `white_dn` holds with it at full brightness.
    box_tick_error
        Relative error of the trigger box's clock.
    """

    cameras: dict[str, CameraSpec] = field(
        default_factory=lambda: {
            "left": CameraSpec("6000001", (-520.0, -1330.0, 470.0), opening_lag_s=0.0621),
            "right": CameraSpec("6000002", (520.0, -1330.0, 430.0), opening_lag_s=0.0634),
        }
    )
    modes: tuple[VibrationMode, ...] = DEFAULT_MODES
    table: TableSpec = field(default_factory=TableSpec)
    sensor: Sensor = field(default_factory=lambda: Sensor(nef=True))
    targets: tuple[SceneTarget, ...] = field(default_factory=frame_targets)
    tags: tuple[SceneTag, ...] = field(default_factory=control_tags)
    survey_sd_mm: float = 0.05
    iso: int = 100
    f_number: float = 32.0
    white_dn: float = 2900.0
    at_s: float = 1.0
    lamp: LampSpec = field(default_factory=LampSpec)
    box_tick_error: float = 4e-5
    seed: int = 1

    @cached_property
    def scene(self) -> Scene:
        """What the cameras see."""
        return Scene(self.targets, self.tags, frame_panels(), seed=self.seed)

    def control_csv(self) -> str:
        """Text of `control.csv`: surveyed centres with the survey's own errors (deterministic by seed)."""
        rng = np.random.default_rng([self.seed, 77])
        lines = ["name,x_mm,y_mm,z_mm,sd_mm"]
        for tag in self.tags:
            x, y, z = np.asarray(tag.centre_mm) + rng.normal(0.0, self.survey_sd_mm, 3)
            lines.append(f"{tag.number},{x:.4f},{y:.4f},{z:.4f},{self.survey_sd_mm:g}")
        return "\n".join(lines) + "\n"

    def targets_csv(self) -> str:
        """Text of `targets.csv`: where the dots are, to a few millimetres (tape-measure accuracy)."""
        rng = np.random.default_rng([self.seed, 78])
        lines = ["name,x_mm,y_mm,z_mm"]
        for target in self.targets:
            x, y, z = np.asarray(target.centre_mm) + rng.normal(0.0, 1.0, 3)
            lines.append(f"{target.name},{x:.1f},{y:.1f},{z:.1f}")
        return "\n".join(lines) + "\n"
