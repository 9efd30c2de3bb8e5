"""A data-set folder on disk: which files belong to which camera, sharp set and capture.

Nothing is decoded here; files are only found, named and checked against each other, so that every complaint about
a folder comes before work begins.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from labdaemon.blur import ExposureWindow, LightCode, named_code
from labdaemon.errors import ConfigError, DataError, UsageError
from labdaemon.events import GaugeMotion
from labdaemon.plain_file import entries
from labdaemon.processing.control import check_family
from labdaemon.processing.rigfile import Finite, Positive, RigFile, one_line, read_rig, read_toml, refuse_unknown_keys
from labdaemon.processing.survey import (
    PatchBox,
    SurveyedPoint,
    TargetPlace,
    read_control,
    read_patches,
    read_targets,
)

NOT_FRAMES = frozenset(
    {".toml", ".csv", ".txt", ".json", ".xmp", ".md", ".part", ".tmp", ".html", ".pdf", ".db", ".ini", ".lnk"}
)
"""Endings of notes, of what is still being written, and of what file managers leave (``Thumbs.db``)."""
SAME_FREQUENCY = 1e-3
"""Relative difference up to which two stated frequencies are one: a generator's setting and a gauge's reading of it."""
GAUGE_CLOCK = 0.05
"""Relative difference up to which a gauge's clock may disagree about a frequency."""
AMBIENT_SD = (0.02, 0.002)
"""Standard deviation of ambient light that is stated without one: relative to it, and in parts of the lamp's light."""
TONE_MAPPED = frozenset({".jpg", ".jpeg", ".heic", ".gif", ".webp"})


class CameraOpening(BaseModel):
    """Opening and exposure time of one body's own shutter, where measured."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="ignore")
    phase_rad: Finite | None = None
    exposure_s: Positive | None = None


class CaptureFile(BaseModel):
    """`capture.toml`: excitation, exposure and light of one capture, as far as known."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="ignore")
    frequency_hz: Positive | None = None
    exposure_s: Positive | None = None
    phase_rad: Finite | None = None
    sd_phase_rad: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    sd_exposure_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    group: str | None = None
    sharp: str | None = None
    light: tuple[Annotated[float, Field(ge=0, le=1)], ...] | None = None
    """Code of the lamp: brightness in equal sectors of one excitation cycle; None for constant light."""
    light_phase_rad: Finite | None = None
    """Excitation phase at which the first sector begins; None where it was not recorded."""
    light_cycles: Annotated[int, Field(ge=1)] | None = None
    """Whole cycles of the code inside the open shutter; as many as fit where it is not given."""
    ambient: Annotated[float, Field(ge=0, le=20, allow_inf_nan=False)] = 0.0
    """Light that is on whenever the shutter is open, in parts of the lamp's full brightness."""
    sd_light_phase_rad: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    sd_ambient: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of `ambient`: a prior, the frame shows it too. None for 2 % of it and 0.002."""
    light_rise_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Time that the lamp takes from dark to full brightness."""
    cameras: dict[str, CameraOpening] = {}
    gauges: dict[str, GaugeMotion] = {}
    """What each gauge saw, by its name."""

    @field_validator("gauges", mode="before")
    @classmethod
    def _named_gauges(cls, gauges: Any) -> Any:
        """Each table with its gauge's name; what a person noted in another form is no motion."""
        if not isinstance(gauges, dict):
            return {}
        return {name: {**one, "gauge": name} for name, one in gauges.items() if isinstance(one, dict)}

    @model_validator(mode="after")
    def _gauges_can_be(self) -> CaptureFile:
        """Refuse what no gauge shows: amplitudes that are no numbers, and a motion at another frequency."""
        for name, motion in self.gauges.items():
            for key, value in motion.model_dump(exclude_none=True).items():
                is_size = key.startswith(("sd_", "amplitude_")) or key in ("h2_mm", "h3_mm", "h4_mm", "h5_mm")
                if isinstance(value, float) and (not math.isfinite(value) or (is_size and value < 0)):
                    raise ValueError(f"gauges.{name}.{key} = {value:g} is no such number")
            seen, stated = motion.frequency_hz, self.frequency_hz
            if seen is not None and stated is not None and abs(seen / stated - 1.0) > GAUGE_CLOCK:
                raise ValueError(f"gauges.{name}.frequency_hz = {seen:g}, but frequency_hz = {stated:g}")
        return self

    @field_validator("light", mode="before")
    @classmethod
    def _code_by_name(cls, light: Any) -> Any:
        """A code as campaigns name it, 1110100 or cos; a list as it is."""
        try:
            return named_code(light) if isinstance(light, str) else light
        except UsageError as exc:
            raise ValueError(str(exc)) from None

    @model_validator(mode="after")
    def _code_fits(self) -> CaptureFile:
        if self.light is None:
            stated = {key for key in self.model_fields_set if "light_" in key or key == "sd_ambient"}
            if stated:
                raise ValueError(
                    f"{min(stated)} is given, but light is not: write the code of the lamp, or leave it out"
                )
            return self
        cycles = self._cycles()
        if cycles is None and self.light_cycles is None:
            raise ValueError("light needs light_cycles, or frequency_hz and exposure_s")
        if cycles is not None and (self.light_cycles or 1) > cycles + 1e-6:
            raise ValueError(
                f"light_cycles = {self.light_cycles or 1} do not fit into an exposure of {cycles:.3g} excitation cycles"
            )
        self.light_code()
        return self

    def _cycles(self) -> float | None:
        """Excitation cycles in the exposure, None where unknown."""
        if self.frequency_hz is None or self.exposure_s is None:
            return None
        return self.frequency_hz * self.exposure_s

    def light_code(self) -> LightCode | None:
        """The code of the lamp, None under constant light."""
        if self.light is None:
            return None
        cycles = self._cycles()
        try:
            return LightCode(
                self.light,
                self.light_phase_rad or 0.0,
                self.light_cycles or max(int((cycles or 1.0) + 1e-6), 1),
                self.ambient,
                2.0 * math.pi * (self.frequency_hz or 0.0) * self.light_rise_s,
                self.sd_light_phase_rad,
                AMBIENT_SD[0] * self.ambient + AMBIENT_SD[1] if self.sd_ambient is None else self.sd_ambient,
                is_phase_known=self.light_phase_rad is not None,
            )
        except UsageError as exc:
            raise ValueError(str(exc)) from None

    def window(self, camera: str) -> ExposureWindow | None:
        """The exposure as this camera saw it; None unless frequency and exposure are both known."""
        own = self.cameras.get(camera, CameraOpening())
        exposure_s = own.exposure_s if own.exposure_s is not None else self.exposure_s
        light = self.light_code()
        if self.frequency_hz is None or exposure_s is None:
            # The code is in step with the excitation, so that its frequency plays no part.
            return None if light is None else ExposureWindow(1.0, float(light.cycles), light=light)
        phase_rad = own.phase_rad if own.phase_rad is not None else self.phase_rad
        return ExposureWindow(self.frequency_hz, exposure_s, phase_rad, self.sd_phase_rad, self.sd_exposure_s, light)


@dataclass(frozen=True, slots=True)
class SharpFiles:
    """One sharp set: per camera the frames to average. `name` is "" for the flat set."""

    name: str
    at_rest: bool
    frames: Mapping[str, tuple[Path, ...]]


@dataclass(frozen=True, slots=True)
class CaptureFiles:
    """One capture: a frame a camera, and what is known of the exposure."""

    name: str
    frames: Mapping[str, Path]
    about: CaptureFile


@dataclass(frozen=True, slots=True)
class DataFolder:
    """A data-set folder, read and checked but not decoded."""

    root: Path
    rig: RigFile
    control: tuple[SurveyedPoint, ...]
    targets: tuple[TargetPlace, ...]
    patches: tuple[PatchBox, ...] = ()

    def sharp(self, name: str | None = None) -> SharpFiles:
        """Files of a sharp set: the named one, else the flat one.

        Raises
        ------
        DataError
            The set or one of its cameras is missing.
        """
        base = self.root / "sharp"
        where = base / _plain(name, "sharp", self.root) if name else base
        if not os.path.isdir(where):
            raise DataError("the sharp set is missing", file=where)
        found = _frames_in(where, tuple(self.rig.cameras), several=True)
        if not found and not name:
            sets = [path.name for path, is_folder in entries(base) if is_folder]
            hint = f"; name one of its sets ({', '.join(sets)}) as `sharp` in capture.toml" if sets else ""
            raise DataError(f"holds no sharp frame{hint}", file=where)
        missing = [camera for camera in self.rig.cameras if camera not in found]
        if missing:
            raise DataError(f"no sharp frame of camera {missing[0]}", file=where)
        return SharpFiles(name or "", _read_at_rest(where), found)

    def sharp_sets(self) -> tuple[str, ...]:
        """All sharp sets in the order in which they name targets: the flat one ("") first, then by name."""
        return sharp_sets(self.root)

    def capture_names(self) -> tuple[str, ...]:
        """All captures, in the order of their names."""
        base = self.root / "captures"
        if not os.path.isdir(base):
            raise DataError("the folder has no captures", file=base)
        names = tuple(path.name for path, is_folder in entries(base) if is_folder and not path.name.startswith("."))
        if not names:
            raise DataError("the folder has no captures", file=base)
        return names

    def capture(self, name: str) -> CaptureFiles:
        """Files of a capture.

        Raises
        ------
        DataError, ConfigError
            A camera's frame is missing or strange, or `capture.toml` is wrong.
        """
        where = self.root / "captures" / _plain(name, "capture", self.root)
        if not os.path.isdir(where):
            raise DataError("no such capture", file=where)
        frames = {
            camera: files[0] for camera, files in _frames_in(where, tuple(self.rig.cameras), several=False).items()
        }
        missing = [camera for camera in self.rig.cameras if camera not in frames]
        if missing:
            raise DataError(f"no frame of camera {missing[0]}", file=where)
        return CaptureFiles(name, frames, _read_capture(where / "capture.toml", tuple(self.rig.cameras)))

    def gauges(self, capture: str) -> tuple[GaugeMotion, ...]:
        """What gauges saw during a capture, by name of the gauge."""
        about = self.capture(capture).about
        return tuple(about.gauges[name] for name in sorted(about.gauges))


def sharp_sets(root: Path) -> tuple[str, ...]:
    """Names of a folder's sharp sets, the flat one ("") first; empty where there is none."""
    base = root / "sharp"
    if not os.path.isdir(base):
        return ()
    found = entries(base)
    has_flat = any(not is_folder and path.suffix.lower() not in NOT_FRAMES for path, is_folder in found)
    named = [path.name for path, is_folder in found if is_folder and not path.name.startswith(".")]
    return (*([""] if has_flat else []), *named)


def open_folder(root: Path) -> DataFolder:
    """Read a data-set folder's rig file and survey.

    Raises
    ------
    DataError, ConfigError
        One line naming the file at fault.
    """
    if not os.path.isdir(root):
        raise DataError("is not a folder", file=root)
    if not os.path.exists(root / "rig.toml"):
        raise ConfigError(
            "is no data-set folder: it has no rig.toml. A campaign's folder lies in campaigns/ of the data folder; "
            "`labdaemon campaigns list` names them",
            source=root,
        )
    rig = read_rig(root / "rig.toml")
    check_family(rig.control.family, root / "rig.toml")
    control = read_control(root / "control.csv", rig.control.size_mm)
    places, boxes = root / "targets.csv", root / "patches.csv"
    targets = read_targets(places, control, rig.control.size_mm) if os.path.exists(places) else ()
    taken = [*(point.name for point in control), *(target.name for target in targets)]
    patches = read_patches(boxes, tuple(rig.cameras), taken) if os.path.exists(boxes) else ()
    return DataFolder(root, rig, control, targets, patches)


def check_frequencies(folder: DataFolder, captures: Sequence[str], group: str) -> None:
    """Check that the captures of a group are of one excitation.

    Raises
    ------
    DataError
        Two of them state different frequencies.
    """
    stated = [(name, folder.capture(name).about.frequency_hz) for name in captures]
    known = [(name, frequency) for name, frequency in stated if frequency is not None]
    for name, frequency in known[1:]:
        first, other = known[0]
        if abs(frequency - other) > SAME_FREQUENCY * other:
            raise DataError(
                f"the captures of group {group} have different frequencies: {other:g} Hz ({first}) and "
                f"{frequency:g} Hz ({name}); give them different groups in capture.toml",
                file=folder.root / "captures" / name,
            )


def _plain(name: str, what: str, root: Path) -> str:
    """A name that stays inside its folder."""
    if not name or name in {".", ".."} or "/" in name or "\\" in name or "\0" in name:
        raise DataError(f"{name!r} cannot name a {what}", file=root)
    return name


def _frames_in(where: Path, cameras: tuple[str, ...], *, several: bool) -> dict[str, tuple[Path, ...]]:
    """Find each camera's frames: CAMERA.ext and, where `several`, CAMERA-2.ext, CAMERA-3.ext … in that order."""
    found: dict[str, dict[int, Path]] = {}
    photographs: dict[str, Path] = {}
    for path, is_folder in entries(where):
        suffix = path.suffix.lower()
        if is_folder or path.name.startswith(".") or suffix in NOT_FRAMES:
            continue
        camera, number = _camera_and_number(path.stem, cameras, several)
        if suffix in TONE_MAPPED:
            photographs.setdefault(camera or path.stem, path)
            continue
        if camera is None:
            known = ", ".join(cameras)
            raise DataError(f"belongs to no camera of rig.toml ({known}); rename or remove it", file=path)
        if number in found.setdefault(camera, {}):
            raise DataError(f"a second frame of camera {camera}, after {found[camera][number].name}", file=path)
        found[camera][number] = path
    for camera, path in photographs.items():
        if camera in cameras and camera not in found:
            raise DataError(
                "a JPEG or other tone-mapped image cannot be measured; give the camera's RAW file", file=path
            )
    return {camera: tuple(found[camera][n] for n in sorted(found[camera])) for camera in cameras if camera in found}


def _camera_and_number(stem: str, cameras: tuple[str, ...], several: bool) -> tuple[str | None, int]:
    if stem in cameras:
        return stem, 1
    match = re.fullmatch(r"(.+)-([1-9]\d*)", stem)
    if several and match and match[1] in cameras:
        return match[1], int(match[2])
    return None, 0


def _read_at_rest(where: Path) -> bool:
    path = where / "set.toml"
    if not os.path.exists(path):
        return True
    table = read_toml(path)
    refuse_unknown_keys(table, frozenset({"at_rest"}), path)
    value: Any = table.get("at_rest", True)
    if not isinstance(value, bool):
        raise ConfigError("must be true or false", source=path, key="at_rest")
    return value


def _read_capture(path: Path, cameras: tuple[str, ...]) -> CaptureFile:
    if not os.path.exists(path):
        return CaptureFile()
    table = read_toml(path)
    refuse_unknown_keys(table, frozenset(CaptureFile.model_fields), path)
    try:
        about = CaptureFile.model_validate(table)
    except ValidationError as exc:
        raise one_line(exc, path) from None
    strange = sorted(set(about.cameras) - set(cameras))
    if strange:
        raise ConfigError("is no camera of rig.toml", source=path, key=f"cameras.{strange[0]}")
    for key, name in (("group", about.group), ("sharp", about.sharp)):
        if name is not None and (not name or "/" in name or name in {".", ".."}):
            raise ConfigError(f"{name!r} cannot be a name", source=path, key=key)
    return about
