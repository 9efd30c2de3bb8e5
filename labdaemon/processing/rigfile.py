"""`rig.toml` of a data-set folder: what a person writes about cameras, targets and control targets.

It is a rig file as the daemon's, checked by the same model (`labdaemon.rig_sections`). The daemon's own file may be
copied here as it is. What only the daemon needs may be missing; where it is there, its keys and values are checked too.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from labdaemon import tomlfile
from labdaemon.errors import ConfigError
from labdaemon.rig_sections import (
    CameraSection,
    ControlSection,
    DriverSection,
    GaugeSection,
    RigSections,
    ShakerSection,
    TriggerSection,
)

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
DRIVER_SECTIONS: dict[str, type[DriverSection]] = {
    "shaker": ShakerSection,
    "trigger": TriggerSection,
    "gauge": GaugeSection,
    "cameras": CameraSection,
}


class _SettingsTable(BaseModel):
    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, extra="ignore")


class CameraSettings(_SettingsTable):
    """A camera's interior orientation, in pixels of LibRaw's visible area, OpenCV's distortion model."""

    image_size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    focal_px: tuple[Positive, Positive] | None = None
    principal_point_px: tuple[Finite, Finite] | None = None
    distortion: tuple[Finite, Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 0.0, 0.0)


class TargetSettings(_SettingsTable):
    """Sizes of the dots in use, millimetres."""

    diameter_mm: tuple[Positive, ...]

    @field_validator("diameter_mm", mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        return (value,) if isinstance(value, (int, float)) else value


class ControlSettings(_SettingsTable):
    """Kind and size of the control targets: side of a tag's black square, or diameter of a ring target's dot."""

    family: str = ControlSection.model_fields["family"].default
    size_mm: Positive


class ProcessingSettings(_SettingsTable):
    """How frames are measured."""

    method: Literal["fit", "paper"] = "fit"


class GaugeEntry(_SettingsTable):
    """A gauge, as far as measuring asks."""

    name: str = ""
    stands_for: str | tuple[str, ...] | None = None

    @property
    def target_patterns(self) -> tuple[str, ...]:
        """`stands_for` as patterns; empty for a gauge that stands for no target."""
        patterns = (self.stands_for,) if isinstance(self.stands_for, str) else self.stands_for or ()
        return tuple("*" if pattern == "all" else pattern for pattern in patterns)


class RigFile(_SettingsTable):
    """The parts of a rig file that processing reads."""

    cameras: dict[str, CameraSettings] = Field(min_length=1)
    targets: TargetSettings
    control: ControlSettings
    processing: ProcessingSettings = ProcessingSettings()
    gauges: tuple[GaugeEntry, ...] = Field(default=(), alias="gauge")

    @property
    def stands_for(self) -> dict[str, tuple[str, ...]]:
        """Patterns of the targets that each gauge stands for, by its name."""
        return {one.name: one.target_patterns for one in self.gauges if one.target_patterns}


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, within the bounds of `labdaemon.tomlfile`.

    Raises
    ------
    ConfigError
        It is missing, too large, or is not TOML: in one line.
    """
    if not os.path.exists(path):
        raise ConfigError("file is missing", source=path)
    return tomlfile.read_toml(path)[1]


def refuse_unknown_keys(table: Mapping[str, Any], known: frozenset[str], path: Path, key: str = "") -> None:
    """Raise `ConfigError` for a key that nearly is one of `known`, or is one without its unit."""
    for name in table:
        if name in known:
            continue
        close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.85)
        whole = [other for other in sorted(known) if other.startswith(f"{name}_")]
        near = [other for other in (*close, *whole) if other not in table]
        if near:
            raise ConfigError(f"unknown key; did you mean {near[0]}?", source=path, key=f"{key}{name}")


def one_line(error: ValidationError, path: Path) -> ConfigError:
    """Say the first thing that pydantic found, in one line with file and key."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    return ConfigError(message[0].lower() + message[1:], source=path, key=key or None)


def read_rig(path: Path) -> RigFile:
    """Read and check a folder's `rig.toml`.

    Raises
    ------
    ConfigError
        The file is missing, malformed, has an unknown key, a value out of range, or a camera that is not calibrated.
    """
    table = read_toml(path)
    _check_sections(table, path)
    try:
        rig = RigFile.model_validate(table)
    except ValidationError as exc:
        raise one_line(exc, path) from None
    for name, settings in rig.cameras.items():
        if settings.focal_px is None or settings.principal_point_px is None:
            missing = "focal_px" if settings.focal_px is None else "principal_point_px"
            raise ConfigError(
                f"no {missing}: the camera is not calibrated; photograph a board and run "
                "`labdaemon calibrate camera FOLDER`, which writes this table",
                source=path,
                key=f"cameras.{name}",
            )
    return rig


def _check_sections(table: dict[str, Any], path: Path) -> None:
    """Refuse what the model of a rig file refuses, but for keys that only the daemon cannot do without."""
    try:
        RigSections.model_validate(table)
    except ValidationError as exc:
        details = [one for one in exc.errors(include_url=False) if one["type"] != "missing" or _is_measured(one["loc"])]
        if details:
            raise tomlfile.worst_mistake(details, table, source=path) from None
    for key, section in _driver_tables(table):
        model = DRIVER_SECTIONS[key.partition(".")[0].partition("[")[0]]
        known = list(model.model_fields)
        if "driver" in section:  # further keys are the driver's, which need not be installed here
            refuse_unknown_keys(section, frozenset(known), path, f"{key}.")
            continue
        for name in section:
            if name not in known:
                near = tomlfile.nearest(name, known)
                hint = f"did you mean {near}?" if near else f"known keys are {', '.join(sorted(known))}"
                raise ConfigError(f"unknown key; {hint}", source=path, key=f"{key}.{name}")


def _is_measured(location: tuple[int | str, ...]) -> bool:
    """Whether a missing key is one that measuring needs."""
    return location[0] in RigFile.model_fields and location[-1] not in {"driver", "serial"}


def _driver_tables(table: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Key and content of every section that may name a driver."""
    for name in ("shaker", "trigger"):
        if name in table:
            yield name, table[name]
    for place, gauge in enumerate(table.get("gauge", ())):
        yield f"gauge[{place}]", gauge
    for name, camera in table["cameras"].items():
        yield f"cameras.{name}", camera
