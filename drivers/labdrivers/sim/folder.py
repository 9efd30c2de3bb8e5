"""Writes a data-set folder as a campaign would have left it, together with the truth: for tests and first tries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labdrivers.sim.dng import write_dng
from labdrivers.sim.folder_scene import WHITE_DN, FolderScene
from labdrivers.sim.lamp import LampPlay, play_code
from labdrivers.sim.layout import SceneLayout, make_layout
from labdrivers.sim.lens import CameraModel, FloatArray, SensorShift
from labdrivers.sim.motions import Harmonic, random_motions
from labdrivers.sim.optics import Optics
from labdrivers.sim.render import render_frame
from labdrivers.sim.scene import Mosaic, Occluder, Scene, TargetTruth
from labdrivers.sim.sensor import Sensor

__all__ = ["WHITE_DN", "FolderScene", "make_folder"]


def make_folder(path: Path | str, scene: FolderScene | None = None, **changes: Any) -> Path:
    """Render a folder of frames, with `rig.toml`, `control.csv` and `truth.csv`.

    Parameters
    ----------
    path
        Folder to write; made if absent.
    scene
        What it shows; the plain scene if None.
    **changes
        Fields of the scene to change, as keywords.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ValueError
        An option is not offered or the labels do not fit.
    TypeError
        There is no such option.
    """
    values = {} if scene is None else {field.name: getattr(scene, field.name) for field in fields(scene)}
    writer = _FolderWriter.open(Path(path), FolderScene.of(**(values | changes)))
    writer.write_sharp()
    rows = ["capture,target,x_mm,y_mm,z_mm,ax,ay,az,bx,by,bz,diameter_mm"]
    for index in range(writer.scene.captures):
        rows += writer.write_capture(index)
    (writer.folder / "truth.csv").write_text("\n".join(rows) + "\n")
    return writer.folder


@dataclass(frozen=True, slots=True)
class _FolderShot:
    """One exposure of a capture."""

    name: str
    opening_rad: float
    code: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _FolderWriter:
    """A folder under construction."""

    folder: Path
    scene: FolderScene
    layout: SceneLayout
    rng: np.random.Generator
    optics: Optics
    body: Sensor

    @classmethod
    def open(cls, folder: Path, scene: FolderScene) -> _FolderWriter:
        """Lay the scene out and write everything but frames."""
        sizes = tuple(float(size) for size in scene.diameters_mm)
        layout = make_layout(
            seed=scene.seed,
            cameras=scene.cameras,
            size=scene.size,
            targets=scene.targets,
            diameters_mm=sizes,
            paper_mm=scene.label_side_mm,
            texture=scene.texture,
            texture_length_mm=scene.texture_length_mm,
            still_paper=scene.still_paper,
            gradient=scene.gradient,
            distance_mm=scene.distance_mm,
        )
        rng = np.random.default_rng([scene.seed, 51])
        # The pinhole is the same; binned pixels are twice as large.
        lens: Literal["gaussian", "airy"] = "gaussian" if scene.gaussian_optics else "airy"
        optics = Optics(lens, pitch_um=layout.pitch_um, sigma_px=0.8 * 6.1 / layout.pitch_um)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "rig.toml").write_text(_rig_toml(layout, sizes))
        (folder / "control.csv").write_text(_control_csv(layout, scene.survey_sd_mm, rng))
        if scene.approximate_places:
            (folder / "targets.csv").write_text(_targets_csv(layout.scene, rng))
        body = Sensor(scene.pattern, read_noise_e=scene.read_noise_e, nef=scene.nef)
        return cls(folder, scene, layout, rng, optics, body)

    def sensor(self, number: int) -> Sensor:
        """The sensor of a camera, by its number."""
        return replace(self.body, serial=6000001 + number)

    def write_sharp(self) -> None:
        """Write the frames at rest."""
        scene = self.scene
        for number, (name, camera) in enumerate(self.layout.cameras.items()):
            for k in range(scene.sharp_frames):
                frame = render_frame(
                    self.layout.scene,
                    camera,
                    optics=self.optics,
                    sensor=self.sensor(number),
                    seed=scene.seed * 1009 + number * 101 + k,
                    white_dn=scene.sharp_white_dn,
                )
                suffix = f"-{k + 1}" if k else ""
                _write(self.folder / "sharp" / f"{name}{suffix}.dng", frame.mosaic, self.sensor(number), 1.0)

    def write_capture(self, index: int) -> list[str]:
        """Write one capture, or the group of its exposures; return its rows of `truth.csv`."""
        scene, label = self.scene, f"c{index + 1}"
        motions = random_motions(
            self.layout.scene,
            self.rng,
            scene.amplitude_mm,
            scene.orbit,
            scene.frequency_hz,
            scene.rest_offset_mm,
            scene.cameras == 1,
            scene.in_phase,
            scene.level,
        )
        rows: list[str] = []
        for shot_number, shot in enumerate(self._shots(label)):
            truth = self._write_shot(shot, motions, index * 17 + shot_number)
            if shot_number == 0:
                rows = [
                    _truth_row(label, target.name, motions[target.name], one.mean_mm, target.diameter_mm)
                    for target, one in zip(self.layout.scene.targets, truth.values(), strict=True)
                ]
            self._describe(shot, label)
        return rows

    def _shots(self, label: str) -> list[_FolderShot]:
        scene = self.scene
        if scene.light is not None:
            # The shutter opens when it likes: its phase plays no part under coded light.
            openings = self.rng.uniform(0.0, 2.0 * np.pi, len(scene.light))
            return [_FolderShot(f"{label}-{k + 1}", float(openings[k]), code) for k, code in enumerate(scene.light)]
        if scene.phase_rad is not None:
            return [_FolderShot(f"{label}-{k + 1}", phase) for k, phase in enumerate(scene.phase_rad)]
        return [_FolderShot(label, 0.0)]

    def _write_shot(
        self, shot: _FolderShot, motions: dict[str, Harmonic], number_in_folder: int
    ) -> dict[str, TargetTruth]:
        """Write the frames of one exposure; return the truth of the last camera's."""
        scene, truth = self.scene, dict[str, TargetTruth]()
        opened_s = self._opened_s(shot)
        lamp = self._lamp(shot)
        for number, (name, camera) in enumerate(self.layout.cameras.items()):
            frame = render_frame(
                self.layout.scene,
                camera,
                motions=motions,
                opened_s=opened_s,
                brightness=None if lamp is None else lamp[0],
                exposure_s=scene.exposure_s,
                frequency_hz=scene.frequency_hz,
                phase_rad=shot.opening_rad,
                white_dn=scene.white_dn,
                shift=_shift(self.rng, scene.camera_shift_px),
                optics=replace(self.optics, defocus_px=scene.defocus_px),
                sensor=self.sensor(number),
                occluders=_cables(self.layout.scene, camera, self.rng, scene.occluded),
                seed=scene.seed * 1009 + 500 + number_in_folder * 7 + number,
            )
            file = self.folder / "captures" / shot.name / f"{name}.dng"
            _write(file, frame.mosaic, self.sensor(number), scene.exposure_s)
            truth = frame.truth
        return truth

    def _opened_s(self, shot: _FolderShot) -> float:
        return shot.opening_rad / (2.0 * np.pi * self.scene.frequency_hz)

    def _lamp(self, shot: _FolderShot) -> tuple[LampPlay, int] | None:
        scene = self.scene
        if shot.code is None:
            return None
        window_s = (self._opened_s(shot), scene.exposure_s)
        return _lamp(
            shot.code,
            window_s,
            scene.frequency_hz,
            scene.light_phase_rad,
            ambient=scene.ambient,
            rise_s=scene.lamp_rise_s,
        )

    def _describe(self, shot: _FolderShot, label: str) -> None:
        """Write `capture.toml`, as much as the scene says."""
        scene = self.scene
        if scene.tell == "nothing":
            return
        phase_rad = shot.opening_rad if scene.tell == "all" and shot.code is None else None
        text = _capture_toml(scene.frequency_hz, scene.exposure_s, phase_rad)
        lamp = self._lamp(shot)
        if shot.code is not None and lamp is not None:
            text += _light_toml(shot.code, scene.light_phase_rad, lamp[1], scene.ambient, scene.lamp_rise_s)
        if shot.name != label:
            text += f'group = "{label}"\n'
        (self.folder / "captures" / shot.name / "capture.toml").write_text(text)


def _lamp(
    code: Sequence[float],
    window_s: tuple[float, float],
    frequency_hz: float,
    phase_rad: float,
    *,
    ambient: float,
    rise_s: float,
) -> tuple[LampPlay, int]:
    """The lamp's course in an exposure, and how many whole cycles of the code it plays: as many as fit."""
    opened_s, exposure_s = window_s
    period_s = 1.0 / frequency_hz
    first = np.ceil((opened_s / period_s) - phase_rad / (2.0 * np.pi)) + phase_rad / (2.0 * np.pi)
    start_s = float(first * period_s)
    cycles = int(np.floor((opened_s + exposure_s - start_s) / period_s + 1e-9))
    levels = tuple(float(level) for level in code)
    return play_code(levels, start_s, period_s, cycles, rise_s=rise_s, ambient=ambient), cycles


def _light_toml(code: Sequence[float], phase_rad: float, cycles: int, ambient: float, rise_s: float) -> str:
    levels = ", ".join(f"{float(level):.6g}" for level in code)
    lines = [f"light = [{levels}]", f"light_phase_rad = {float(phase_rad)!r}", f"light_cycles = {cycles}"]
    lines += [f"ambient = {float(ambient)!r}", f"light_rise_s = {float(rise_s)!r}"]
    return "\n".join(lines) + "\n"


def _write(file: Path, mosaic: Mosaic, sensor: Sensor, exposure_s: float) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_dng(
        file, mosaic, sensor.pattern, sensor.black, sensor.white, serial=str(sensor.serial), exposure_s=exposure_s
    )


def _shift(rng: np.random.Generator, size_px: float) -> SensorShift:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return SensorShift(size_px * float(np.cos(angle)), size_px * float(np.sin(angle)), 2e-5 * size_px)


def _cables(scene: Scene, camera: CameraModel, rng: np.random.Generator, count: int) -> tuple[Occluder, ...]:
    chosen = rng.permutation(len(scene.targets))[:count]
    hung = []
    for index in chosen:
        target = scene.targets[index]
        ends = np.array([target.centre_mm, (target.centre_mm[0] + target.diameter_mm, *target.centre_mm[1:])])
        (x, y), rim = camera.project(ends)
        width = 0.35 * float(rim[0] - x)
        x = x + 0.2 * width
        half = 2.2 * float(rim[0] - x)
        corners = ((x - width, y - half), (x, y - half), (x + width, y + half), (x, y + half))
        hung.append(Occluder(tuple((float(a), float(b)) for a, b in corners)))
    return tuple(hung)


def _rig_toml(layout: SceneLayout, diameters_mm: tuple[float, ...]) -> str:
    lines = []
    for name, camera in layout.cameras.items():
        lines += [
            f"[cameras.{name}]",
            f"image_size = {list(camera.image_size)}",
            f"focal_px = {list(camera.focal_px)}",
            f"principal_point_px = {list(camera.principal_point_px)}",
            f"distortion = {list(camera.distortion)}",
            "",
        ]
    unique = sorted(set(diameters_mm))
    lines += ["[targets]", f"diameter_mm = {unique[0] if len(unique) == 1 else unique}", ""]
    lines += ["[control]", 'family = "apriltag-36h11"', f"size_mm = {layout.scene.tags[0].size_mm:g}", ""]
    return "\n".join(lines)


def _control_csv(layout: SceneLayout, sd_mm: float, rng: np.random.Generator) -> str:
    lines = ["name,x_mm,y_mm,z_mm,sd_mm"]
    for tag in layout.scene.tags:
        x, y, z = np.asarray(tag.centre_mm) + rng.normal(0.0, sd_mm, 3)
        lines.append(f"{tag.number},{x:.4f},{y:.4f},{z:.4f},{sd_mm:g}")
    return "\n".join(lines) + "\n"


def _targets_csv(scene: Scene, rng: np.random.Generator) -> str:
    lines = ["name,x_mm,y_mm,z_mm"]
    for target in scene.targets:
        x, y, z = np.asarray(target.centre_mm) + rng.normal(0.0, 1.0, 3)
        lines.append(f"{target.name},{x:.1f},{y:.1f},{z:.1f}")
    return "\n".join(lines) + "\n"


def _capture_toml(frequency_hz: float, exposure_s: float, phase_rad: float | None) -> str:
    lines = [f"frequency_hz = {float(frequency_hz)!r}", f"exposure_s = {float(exposure_s)!r}"]
    if phase_rad is not None:
        lines.append(f"phase_rad = {float(phase_rad)!r}")
    return "\n".join(lines) + "\n"


def _truth_row(capture: str, name: str, motion: Harmonic, mean_mm: FloatArray, diameter_mm: float) -> str:
    numbers = [*mean_mm, *motion.a_mm, *motion.b_mm]
    return ",".join([capture, name, *(f"{float(v):.6f}" for v in numbers), f"{diameter_mm:g}"])
