"""The rig file: read, checked to the last key, and turned into what the daemon is built from."""

from __future__ import annotations

import hashlib
import json
import os
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from labdaemon.campaign.light_plan import ImageScale
from labdaemon.campaign.limits import ShakerLimits
from labdaemon.campaign.plan import PlanRig
from labdaemon.capture.abilities import ExcitationChecker, SettingsSource
from labdaemon.capture.exposure import third_stop_steps_s, true_steps_s
from labdaemon.errors import ConfigError, LimitError
from labdaemon.rig_sections import DriverSection, RigSections
from labdaemon.service.lamp_settings import image_scale, lamp_of
from labdaemon.stream.access_token import AccessToken
from labdaemon.tomlfile import nearest, parse_model, read_toml

RAW_BYTES_A_PIXEL = 2
"""An uncompressed 16-bit mosaic, the largest that a frame can be; bodies that compress need less."""
DEFAULT_IMAGE_SIZE = (6000, 4000)
"""Assumed for disk use when a camera's section has none."""
BUILT_IN = {"trigger": {"camera"}}
"""Drivers that are the daemon itself: frames that arrive are the trigger."""


class RigConfig(RigSections):
    """A whole rig file.

    Attributes
    ----------
    source
        Where it was read from; relative paths in it start at its folder.
    """

    source: Annotated[Path, Field(exclude=True, alias=" source")]

    @property
    def limits(self) -> ShakerLimits | None:
        """The table's limits, None without a shaker."""
        return ShakerLimits(**self.shaker.limits.model_dump()) if self.shaker else None

    @property
    def data(self) -> Path:
        """Folder for everything the daemon writes."""
        return self.path(self.service.data)

    def path(self, written: str) -> Path:
        """A path of the file, relative to the file's own folder."""
        return (self.source.parent / written).resolve()

    def shaker_settings(self) -> dict[str, Any]:
        """The shaker's section for its driver, with the calibration's path made absolute."""
        if self.shaker is None:
            return {}
        settings = self.shaker.settings
        if self.shaker.calibration is not None:
            settings["calibration"] = str(self.path(self.shaker.calibration))
        return settings

    @property
    def digest(self) -> str:
        """SHA-256 of what results and safety depend on; addresses, folders and worker counts may change freely."""
        aside: Any = dict.fromkeys(("service", "source", "guardian", "gateway", "web"), True)
        aside["processing"] = {"workers", "deadline_s"}
        parts = self.model_dump(mode="json", exclude=aside)
        control = self.path(self.control.file)
        parts["control_csv"] = hashlib.sha256(control.read_bytes()).hexdigest() if os.path.exists(control) else None
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def load_rig(path: Path | str, *, check_drivers: bool = True, check_files: bool = True) -> RigConfig:
    """Read and check a rig file.

    Parameters
    ----------
    path
        The TOML file.
    check_drivers
        Also look up every driver, refuse keys that it does not know, and let it check its values (this opens nothing).

    check_files
        Also read the survey, look for the other files that it names, and refuse cameras that are not calibrated. Who
        only wants to stop the table does not.

    Raises
    ------
    ConfigError
        Names file and key: unknown key (with the nearest known one), wrong type, value out of range, unknown driver,
        two of one name or serial number, a file that is not there, a camera that is not calibrated.
    DataError
        The survey is no survey; names its file.
    """
    source = Path(path)
    _, data = read_toml(source)
    if isinstance(data.get("gauge"), dict):
        raise ConfigError("is one table; write [[gauge]] with double brackets", source=source, key="gauge")
    rig = parse_model(RigConfig, {**data, " source": source}, source=source)
    _check_names(rig)
    if check_files:
        _check_files(rig)
        _check_servers(rig)
    if check_drivers:
        for key, kind, name, section in _driver_sections(rig):
            settings = rig.shaker_settings() if kind == "shaker" else section.settings
            _check_driver(source, key, kind, name, section, settings)
    if check_files:
        _check_lenses(rig)
    return rig


def plan_rig(
    rig: RigConfig, *, exposure_steps_s: dict[str, tuple[float, ...]] | None = None, free_bytes: int | None = None
) -> PlanRig:
    """What planning needs of a rig.

    Parameters
    ----------
    exposure_steps_s
        What the bodies say they offer (`Camera.exposure_steps_s`), by camera; without it the file's own list, and
        without that the usual thirds of a stop.
    free_bytes
        Room on disk; None not to check it.
    """
    steps: dict[str, tuple[float, ...]] = {}
    frame_bytes: dict[str, int] = {}
    for name, camera in rig.cameras.items():
        named = (exposure_steps_s or {}).get(name) or camera.exposure_steps_s
        steps[name] = true_steps_s(named) if named else third_stop_steps_s()
        width, height = camera.image_size or DEFAULT_IMAGE_SIZE
        frame_bytes[name] = width * height * RAW_BYTES_A_PIXEL
    return PlanRig(
        rig.limits,
        steps,
        frame_bytes,
        free_bytes,
        refusal=partial(_refusal, _build_shaker(rig)),
        can_fire=rig.trigger.driver not in BUILT_IN["trigger"],
        digest=rig.digest,
        lamp=lamp_of(rig),
        scale=image_scale(rig) if rig.lamp is not None else ImageScale(),
    )


def _build_shaker(rig: RigConfig) -> Any:
    """The shaker's driver, not connected; None without one, or when it is not installed."""
    if rig.shaker is None:
        return None
    installed = entry_points(group="labdaemon.shakers")
    if rig.shaker.driver not in installed.names:
        return None
    return installed[rig.shaker.driver].load()("shaker", rig.shaker_settings())


def _refusal(shaker: object, frequency_hz: float, amplitude_mm: float) -> str | None:
    """Why the driver would not set this. Its `check`, if it has one, sends nothing."""
    if not isinstance(shaker, ExcitationChecker):
        return None
    try:
        shaker.check(frequency_hz, amplitude_mm)
    except LimitError as exc:
        return str(exc)
    return None


def find_driver(kind: str, driver: str) -> EntryPoint:
    """The entry point of a driver.

    Parameters
    ----------
    kind
        ``shaker``, ``trigger``, ``camera`` or ``gauge``.

    Raises
    ------
    ConfigError
        None is installed under this name; the message names those that are.
    """
    installed = entry_points(group=f"labdaemon.{kind}s")
    if driver in installed.names:
        return installed[driver]
    names = sorted(installed.names | BUILT_IN.get(kind, set()))
    near = nearest(driver, names)
    hint = f"did you mean {near}?" if near else f"installed are {', '.join(names) or 'none'}"
    raise ConfigError(f"no {kind} driver {driver!r}; {hint}")


def _driver_sections(rig: RigConfig) -> list[tuple[str, str, str, DriverSection]]:
    """Key, kind, device's name and section of everything that names a driver."""
    sections: list[tuple[str, str, str, DriverSection]] = [("trigger", "trigger", "trigger", rig.trigger)]
    if rig.shaker is not None:
        sections.append(("shaker", "shaker", "shaker", rig.shaker))
    sections += [(f"gauge[{place}]", "gauge", gauge.name, gauge) for place, gauge in enumerate(rig.gauges)]
    sections += [(f"cameras.{name}", "camera", name, camera) for name, camera in rig.cameras.items()]
    return sections


def _check_driver(
    source: Path, key: str, kind: str, name: str, section: DriverSection, settings: dict[str, Any]
) -> None:
    """Refuse a driver that is not installed, keys that neither we nor it know, and values that it refuses."""
    known = list(type(section).model_fields)
    driver: Any = None
    if section.driver not in BUILT_IN.get(kind, set()):
        try:
            entry = find_driver(kind, section.driver)
        except ConfigError as exc:
            raise ConfigError(str(exc), source=source, key=f"{key}.driver") from None
        try:
            driver = entry.load()
        except Exception as exc:  # it is another package's, whose import may do and raise anything
            raise ConfigError(
                f"driver {entry.value} does not load: {type(exc).__name__}: {exc}", source=source, key=f"{key}.driver"
            ) from exc
        known += sorted(driver.SETTINGS if isinstance(driver, SettingsSource) else section.driver_keys)
    for written in sorted(section.driver_keys - set(known)):
        near = nearest(written, known)
        hint = f"did you mean {near}?" if near else f"known keys are {', '.join(sorted(known))}"
        raise ConfigError(f"unknown key; {hint}", source=source, key=f"{key}.{written}")
    if driver is not None:
        try:
            driver(name, settings)
        except ConfigError as exc:
            inner = (exc.key or "").removeprefix(key).removeprefix(name).strip(".")
            message = str(exc).removeprefix(f"{exc.key}: ")
            raise ConfigError(message, source=source, key=f"{key}.{inner}" if inner else key) from None
        except Exception as exc:  # a slip of the driver is no traceback for whoever wrote the rig file
            raise ConfigError(
                f"its driver does not take this section ({type(exc).__name__}: {exc})", source=source, key=key
            ) from exc


def _check_files(rig: RigConfig) -> None:
    from labdaemon.processing import check_family, read_control, read_patches, read_targets

    check_family(rig.control.family, rig.source)
    named = [("control.file", rig.control.file), ("targets.file", rig.targets.file)]
    named.append(("targets.patches", rig.targets.patches))
    named.append(("shaker.calibration", rig.shaker.calibration if rig.shaker else None))
    for key, written in named:
        if written is not None and not os.path.isfile(rig.path(written)):
            raise ConfigError(f"{rig.path(written)} is not there", source=rig.source, key=key)
    control = read_control(rig.path(rig.control.file), rig.control.size_mm)
    taken = [point.name for point in control]
    if rig.targets.file is not None:
        taken += [one.name for one in read_targets(rig.path(rig.targets.file), control, rig.control.size_mm)]
    if rig.targets.patches is not None:
        read_patches(rig.path(rig.targets.patches), tuple(rig.cameras), taken)


def _check_servers(rig: RigConfig) -> None:
    """Refuse servers that could not serve: a token that others read, or that is missing; a package that is."""
    _check_policy(rig)
    named = [("gateway.token_file", rig.gateway.token_file if rig.gateway else None)]
    if rig.web is not None:
        named += [("web.token_file", rig.web.token_file), ("web.observer_token_file", rig.web.observer_token_file)]
        missing = [name for name in ("starlette", "uvicorn") if find_spec(name) is None]
        if missing:
            message = f"{' and '.join(missing)} not installed; run: pip install 'labdaemon[web]'"
            raise ConfigError(message, source=rig.source, key="web")
    for key, written in named:
        if written is not None:
            AccessToken(rig.path(written), key)


def _check_policy(rig: RigConfig) -> None:
    """No way in is wider than the policy; and one that no one could use is a slip."""
    if not rig.service.restricts_operators:
        return
    policy = f"local_operators is {rig.service.local_policy} here, and this port is open to everyone on this machine"
    if rig.gateway is not None and rig.gateway.token_file is None:
        message = f"is needed: {policy}, who could command; or write local_operators = all"
        raise ConfigError(message, source=rig.source, key="gateway.token_file")
    if rig.web is not None and rig.web.token_file is None and rig.web.observer_token_file is None:
        message = f"is needed (or token_file): {policy}, who could read; or write local_operators = all"
        raise ConfigError(message, source=rig.source, key="web.observer_token_file")


def _check_lenses(rig: RigConfig) -> None:
    """Refuse a camera that no frame could be measured with: a whole night's captures would come to nothing."""
    for name, camera in rig.cameras.items():
        if camera.focal_px is None:
            raise ConfigError(
                "no focal_px: the camera is not calibrated; photograph a board with it and run `labdaemon calibrate "
                "camera FOLDER`, which writes image_size, focal_px, principal_point_px and distortion",
                source=rig.source,
                key=f"cameras.{name}",
            )


def _check_names(rig: RigConfig) -> None:
    seen: dict[str, str] = {}
    for name, camera in rig.cameras.items():
        if camera.serial in seen:
            other = seen[camera.serial]
            key = f"cameras.{name}.serial"
            raise ConfigError(f"{camera.serial} is camera {other}'s already", source=rig.source, key=key)
        seen[camera.serial] = name
    names = [gauge.name for gauge in rig.gauges]
    for place, name in enumerate(names):
        if name in names[:place]:
            raise ConfigError(f"{name} is another gauge's already", source=rig.source, key=f"gauge[{place}].name")
