"""The rig file of a simulated rig: text in the form that `labdaemon run` reads, made from the rig's own numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from labdrivers.sim.spec import RigSpec

PORTS = {name: f"sim://{name}" for name in ("shaker", "trigger", "gauge-table", "gauge-response")}
"""Devices of the rig in the daemon's own process."""


def rig_toml(
    spec: RigSpec,
    *,
    ports: Mapping[str, str] = PORTS,
    camera_settings: Mapping[str, Any] | None = None,
    events: str = "tcp://127.0.0.1:5571",
    commands: str = "tcp://127.0.0.1:5570",
    data: str = "../data/sim",
    control_file: str = "sim-control.csv",
    targets_file: str = "sim-targets.csv",
    reports: bool = True,
) -> str:
    """Text of a rig file.

    Parameters
    ----------
    spec
        The simulated rig.
    ports
        pyserial URL of ``shaker``, ``trigger``, ``gauge-table`` and ``gauge-response``.
    camera_settings
        Keys of every camera's section that say how to reach it; ``backend = "sim"`` by default.
    events, commands, data
        The daemon's addresses and folder.
    control_file, targets_file
        Where `RigSpec.control_csv` and `RigSpec.targets_csv` are written, in the rig file's folder.
    reports
        Whether the daemon writes the page of each campaign that ends.
    """
    table = spec.table
    sections = [
        _section("[service]", events=events, commands=commands, data=data, **({} if reports else {"reports": False})),
        "[shaker]\n" + _lines(driver="scpi", port=ports["shaker"]) + _drive(table.calibration()),
        _section(
            "[shaker.limits]",
            stroke_mm=table.stroke_mm,
            velocity_mm_s=table.velocity_mm_s,
            acceleration_mm_s2=table.acceleration_mm_s2,
            frequency_hz=table.frequency_hz,
        ),
        _section("[trigger]", driver="box", port=ports["trigger"]),
        _section("[lamp]", rise_s=spec.lamp.rise_s, ambient=spec.lamp.ambient, levels=spec.lamp.levels),
    ]
    for role in ("table", "response"):
        port = ports[f"gauge-{role}"]
        sections.append(_section("[[gauge]]", name=role, driver="line", role=role, unit="mm", port=port))
    for name, camera in spec.cameras.items():
        reached = camera_settings or {"backend": "sim"}
        sections.append(
            _section(
                f"[cameras.{name}]",
                driver="ptp",
                serial=camera.serial,
                **reached,
                exposure_s=spec.at_s,
                f_number=spec.f_number,
                iso=spec.iso,
                image_size=camera.image_size,
                focal_px=camera.focal_px,
                principal_point_px=camera.principal_point_px,
                distortion=camera.distortion,
            )
        )
    sizes = sorted({target.diameter_mm for target in spec.targets})
    sections += [
        _section("[targets]", diameter_mm=sizes[0] if len(sizes) == 1 else sizes, file=targets_file),
        _section("[control]", family="apriltag-36h11", size_mm=spec.tags[0].size_mm, file=control_file),
        _section("[interlocks]", max_response_mm=60.0, max_response_rate_mm_s=50.0),
    ]
    if not ports["shaker"].startswith("sim:"):
        # A rig of another process is gone for good once that has ended, and another device may get its port number.
        sections.append(_section("[guardian]", patience_s=60.0))
    return "\n".join(sections)


def write_rig_files(folder: Path, spec: RigSpec, **reached: Any) -> Path:
    """Write `rig.toml`, `control.csv` and `targets.csv` into a folder; returns the rig file's path.

    Parameters
    ----------
    reached
        As `rig_toml` takes them: ports, addresses, the daemon's folder.
    """
    text = rig_toml(spec, control_file="control.csv", targets_file="targets.csv", **reached)
    for name, content in (("control.csv", spec.control_csv()), ("targets.csv", spec.targets_csv()), ("rig.toml", text)):
        (folder / name).write_text(content, encoding="utf-8")
    return folder / "rig.toml"


def _section(head: str, **values: Any) -> str:
    return f"{head}\n{_lines(**values)}"


def _lines(**values: Any) -> str:
    return "".join(f"{key} = {_value(value)}\n" for key, value in values.items())


def _drive(calibration: Sequence[tuple[float, float]]) -> str:
    rows = "".join(f"    {{ frequency_hz = {f!r}, mm_per_v = {mm!r} }},\n" for f, mm in calibration)
    return f"drive = [\n{rows}]\n"


def _value(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Sequence):
        return "[" + ", ".join(_value(part) for part in value) + "]"
    return repr(value)
