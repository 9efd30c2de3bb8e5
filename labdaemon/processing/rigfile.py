"""`rig.toml` of a data-set folder: what a person writes about cameras, targets and control targets.

The daemon's own rig file may be copied here as it is: sections and keys that only its devices need are left alone.
A key that is nearly one of ours is a slip of the pen and is refused.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from labdaemon import tomlfile
from labdaemon.errors import ConfigError

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class CameraSettings(_Table):
    """A camera's interior orientation, in pixels of LibRaw's visible area, OpenCV's distortion model."""

    image_size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    focal_px: tuple[Positive, Positive] | None = None
    principal_point_px: tuple[Finite, Finite] | None = None
    distortion: tuple[Finite, Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 0.0, 0.0)


class TargetSettings(_Table):
    """Sizes of the dots in use, millimetres."""

    diameter_mm: tuple[Positive, ...]

    @field_validator("diameter_mm", mode="before")
    @classmethod
    def _one_or_many(cls, value: object) -> object:
        return (value,) if isinstance(value, (int, float)) else value


class ControlSettings(_Table):
    """Kind and size of the control targets: side of a tag's black square, or diameter of a ring target's dot."""

    family: str
    size_mm: Positive


class ProcessingSettings(_Table):
    """How frames are measured."""

    method: Literal["fit", "paper"] = "fit"


class RigFile(_Table):
    """The parts of a rig file that processing reads."""

    cameras: dict[str, CameraSettings] = Field(min_length=1)
    targets: TargetSettings
    control: ControlSettings
    processing: ProcessingSettings = ProcessingSettings()


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, within the bounds of `labdaemon.tomlfile`.

    Raises
    ------
    ConfigError
        It is missing, too large, or is not TOML: in one line.
    """
    if not path.exists():
        raise ConfigError("file is missing", source=path)
    return tomlfile.read_toml(path)[1]


def refuse_misspelt(table: Mapping[str, Any], known: frozenset[str], path: Path, key: str = "") -> None:
    """Raise `ConfigError` for a key that nearly is one of `known`."""
    for name in table:
        if name in known:
            continue
        near = [
            other for other in difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.85) if other not in table
        ]
        if near:
            raise ConfigError(f"unknown key; did you mean {near[0]}?", source=path, key=f"{key}{name}")


def one_line(error: ValidationError, path: Path) -> ConfigError:
    """Say the first thing that pydantic found, in one line with file and key."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    return ConfigError(first["msg"][0].lower() + first["msg"][1:], source=path, key=key or None)


def read_rig(path: Path) -> RigFile:
    """Read and check a folder's `rig.toml`.

    Raises
    ------
    ConfigError
        The file is missing, malformed, has a misspelt key, a camera that is not calibrated, or sizes that can only be
        metres.
    """
    table = read_toml(path)
    refuse_misspelt(table, frozenset(RigFile.model_fields), path)
    sections: list[tuple[str, Any, type[BaseModel]]] = [
        ("targets.", table.get("targets"), TargetSettings),
        ("control.", table.get("control"), ControlSettings),
    ]
    cameras = table.get("cameras")
    if isinstance(cameras, dict):
        sections += [(f"cameras.{name}.", camera, CameraSettings) for name, camera in cameras.items()]
    for prefix, section, model in sections:
        if isinstance(section, dict):
            refuse_misspelt(section, frozenset(model.model_fields), path, prefix)
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
    if rig.control.size_mm < 1.0:
        raise ConfigError(f"{rig.control.size_mm} mm looks like metres", source=path, key="control.size_mm")
    if min(rig.targets.diameter_mm) < 0.2:
        raise ConfigError(
            f"{min(rig.targets.diameter_mm)} mm looks like metres", source=path, key="targets.diameter_mm"
        )
    return rig
