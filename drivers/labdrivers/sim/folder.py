"""Writes a data-set folder as a campaign would have left it, together with the truth: for tests and first tries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labdrivers.sim.dng import write_dng
from labdrivers.sim.lamp import LampPlay, play_code
from labdrivers.sim.layout import SceneLayout, make_layout
from labdrivers.sim.lens import CameraModel, FloatArray, SensorShift
from labdrivers.sim.motions import Harmonic, random_motions
from labdrivers.sim.optics import Optics
from labdrivers.sim.render import render_frame
from labdrivers.sim.scene import Mosaic, Occluder, Scene
from labdrivers.sim.sensor import Sensor

WHITE_DN = 2900.0


def make_folder(
    path: Path | str,
    *,
    seed: int = 0,
    cameras: int = 2,
    size: str = "small",
    targets: int = 24,
    diameters_mm: Sequence[float] = (8.0,),
    amplitude_mm: tuple[float, float] = (0.3, 3.0),
    orbit: float = 0.0,
    in_phase: bool = False,
    captures: int = 1,
    frequency_hz: float = 5.0,
    exposure_s: float = 1.0,
    phase_rad: Sequence[float] | None = None,
    light: Sequence[Sequence[float]] | None = None,
    light_phase_rad: float = 0.0,
    ambient: float = 0.0,
    lamp_rise_s: float = 0.0,
    tell: str = "all",
    rest_offset_mm: float = 0.0,
    sharp_frames: int = 1,
    camera_shift_px: float = 0.0,
    defocus_px: float = 0.0,
    white_dn: float = WHITE_DN,
    sharp_white_dn: float = WHITE_DN,
    occluded: int = 0,
    paper_mm: float | None = None,
    texture: float = 0.004,
    texture_length_mm: float = 0.3,
    still_paper: bool = False,
    gradient: tuple[float, float] = (0.08, -0.05),
    read_noise_e: float = 7.0,
    gaussian_optics: bool = False,
    nef: bool = True,
    pattern: str = "RGGB",
    survey_sd_mm: float = 0.05,
    distance_mm: float = 1000.0,
    approximate_places: bool = False,
) -> Path:
    """Render a folder of frames, with `rig.toml`, `control.csv` and `truth.csv`.

    Parameters
    ----------
    path
        Folder to write; made if absent.
    seed
        Of everything random in it.
    cameras
        1 (planar motion), 2 or 3 (motion in space).
    size
        ``small`` (1936 x 1296, 12.2 µm pixels) or ``d80`` (3900 x 2613, 6.1 µm).
    targets, diameters_mm
        How many dots, and their diameters in turn.
    amplitude_mm
        Smallest and largest semi-amplitude; drawn evenly in their logarithm.
    orbit
        Ratio of minor to major semi-axis, 0 for straight paths.
    in_phase
        All targets of a capture move in or against one phase, as a structure does in one of its modes.
    captures
        How many, each with motions of its own.
    frequency_hz, exposure_s
        Excitation and shutter; a product that is no whole number leaves a part cycle.
    phase_rad
        Opening phases. Every capture then becomes a group of exposures of the same motion, one at each phase.
    light
        Codes of the lamp, as brightnesses of equal sectors of one cycle. Every capture then becomes a group of
        exposures of the same motion, one under each code.
    light_phase_rad, ambient, lamp_rise_s
        Excitation phase at which the codes begin, the room's light in parts of the lamp's, and the lamp's rise time.
    tell
        What `capture.toml` says: ``all`` (frequency, exposure, phase and group), ``window`` (no phase) or ``nothing``.
    rest_offset_mm
        Standard deviation by which the mean position differs from rest.
    sharp_frames
        Frames at rest, each with its own noise.
    camera_shift_px, defocus_px
        How far each blurred frame is shifted on the sensor against the sharp one (in a random direction), and how
        much it is out of focus (diameter of the blur circle).
    white_dn, sharp_white_dn
        What white paper reads in the middle of blurred and of sharp frames; above 4095 it is clipped.
    occluded
        How many targets of each blurred frame have a cable hanging before them.
    paper_mm
        Side of the labels; by default so large that their own smeared edges stay clear of the dots' smears.
    texture, texture_length_mm, still_paper, gradient
        Relative sd of the paper texture; labels that do not move with their dots; slope of the light (see `Scene`).
    read_noise_e
        Of the sensor, electrons.
    gaussian_optics, nef, pattern
        Gaussian lens blur in place of diffraction; the D80's compression; colour mosaic.
    survey_sd_mm
        Error of the surveyed control points, as stated in their file.
    distance_mm
        From cameras to targets.
    approximate_places
        Write `targets.csv` as well.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ValueError
        If an option is not offered or the labels do not fit.
    """
    if tell not in ("all", "window", "nothing"):
        raise ValueError(f"tell must be 'all', 'window' or 'nothing', not {tell!r}")
    folder = Path(path)
    sizes = tuple(float(d) for d in diameters_mm)
    # The label's edge comes as near as half a side less the amplitude to where the dot goes.
    edges = 2.0 if still_paper else 4.0
    side = max(sizes) + edges * amplitude_mm[1] + 10.0 + (6.0 * rest_offset_mm if still_paper else 0.0)
    if paper_mm is not None:
        side = paper_mm
    layout = make_layout(
        seed=seed,
        cameras=cameras,
        size=size,
        targets=targets,
        diameters_mm=sizes,
        paper_mm=side,
        texture=texture,
        texture_length_mm=texture_length_mm,
        still_paper=still_paper,
        gradient=gradient,
        distance_mm=distance_mm,
    )
    rng = np.random.default_rng([seed, 51])
    # The pinhole is the same; binned pixels are twice as large.
    optics = Optics(
        "gaussian" if gaussian_optics else "airy", pitch_um=layout.pitch_um, sigma_px=0.8 * 6.1 / layout.pitch_um
    )
    body = Sensor(pattern, read_noise_e=read_noise_e, nef=nef)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(_rig_toml(layout, sizes))
    (folder / "control.csv").write_text(_control_csv(layout, survey_sd_mm, rng))
    if approximate_places:
        (folder / "targets.csv").write_text(_targets_csv(layout.scene, rng))
    for number, (name, camera) in enumerate(layout.cameras.items()):
        sensor = replace(body, serial=6000001 + number)
        for k in range(sharp_frames):
            seed_k = seed * 1009 + number * 101 + k
            sharp = render_frame(
                layout.scene, camera, optics=optics, sensor=sensor, seed=seed_k, white_dn=sharp_white_dn
            )
            suffix = f"-{k + 1}" if k else ""
            _write(folder / "sharp" / f"{name}{suffix}.dng", sharp.mosaic, sensor, 1.0)
    rows = ["capture,target,x_mm,y_mm,z_mm,ax,ay,az,bx,by,bz,diameter_mm"]
    for index in range(captures):
        motions = random_motions(
            layout.scene, rng, amplitude_mm, orbit, frequency_hz, rest_offset_mm, cameras == 1, in_phase
        )
        label = f"c{index + 1}"
        shots: list[tuple[str, float, Sequence[float] | None]] = [(label, 0.0, None)]
        if phase_rad is not None:
            shots = [(f"{label}-{k + 1}", phase, None) for k, phase in enumerate(phase_rad)]
        if light is not None:
            # The shutter opens when it likes: its phase plays no part under coded light.
            opening_phases = rng.uniform(0.0, 2.0 * np.pi, len(light))
            shots = [(f"{label}-{k + 1}", float(opening_phases[k]), code) for k, code in enumerate(light)]
        for shot, (capture, opening, code) in enumerate(shots):
            opened_s = opening / (2.0 * np.pi * frequency_hz)
            lamp = None
            if code is not None:
                lamp = _lamp(
                    code, (opened_s, exposure_s), frequency_hz, light_phase_rad, ambient=ambient, rise_s=lamp_rise_s
                )
            truth_rows: list[str] = []
            for number, (name, camera) in enumerate(layout.cameras.items()):
                sensor = replace(body, serial=6000001 + number)
                frame = render_frame(
                    layout.scene,
                    camera,
                    motions=motions,
                    opened_s=opened_s,
                    brightness=None if lamp is None else lamp[0],
                    exposure_s=exposure_s,
                    frequency_hz=frequency_hz,
                    phase_rad=opening,
                    white_dn=white_dn,
                    shift=_shift(rng, camera_shift_px),
                    optics=replace(optics, defocus_px=defocus_px),
                    sensor=sensor,
                    occluders=_cables(layout.scene, camera, rng, occluded),
                    seed=seed * 1009 + 500 + ((index * 17 + shot) * 7 + number),
                )
                _write(folder / "captures" / capture / f"{name}.dng", frame.mosaic, sensor, exposure_s)
                truth_rows = [
                    _truth_row(label, target.name, motions[target.name], truth.mean_mm, target.diameter_mm)
                    for target, truth in zip(layout.scene.targets, frame.truth.values(), strict=True)
                ]
            if tell != "nothing":
                text = _capture_toml(frequency_hz, exposure_s, opening if tell == "all" and code is None else None)
                if code is not None and lamp is not None:
                    text += _light_toml(code, light_phase_rad, lamp[1], ambient, lamp_rise_s)
                if len(shots) > 1:
                    text += f'group = "{label}"\n'
                (folder / "captures" / capture / "capture.toml").write_text(text)
            if shot == 0:
                rows += truth_rows
    (folder / "truth.csv").write_text("\n".join(rows) + "\n")
    return folder


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
