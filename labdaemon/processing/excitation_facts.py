"""What is known of each capture of a data-set folder: excitation, time, motion of the table, phase shown or not."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

from labdaemon.errors import ConfigError, DataError
from labdaemon.tomlfile import read_toml

PART_CYCLE = 0.05
"""Cycles from which an exposure is not whole any more, as for the flag part_cycles."""
STATED_TABLE_SD = 0.002
"""Relative sd of the table's amplitude where it is only stated: a calibrated controller holds it so well."""
LEAST_TABLE_SD = 2e-4
"""Smallest relative sd of an amplitude that a gauge saw: its record and the exposure are not quite the same time."""
SHOWN = 4
"""Names that a message lists."""
LARGEST_GAUGE_SD = 0.1
"""Relative sd from which on a gauge's amplitude is not used."""


@dataclass(frozen=True, slots=True)
class TableAmplitude:
    """Motion of the table during a capture, as a gauge on it saw it, else as it was set.

    Attributes
    ----------
    amplitude_mm, sd_mm
        Zero to peak, and its standard deviation.
    phase_rad, sd_phase_rad
        Against the excitation's phase reference, as ``amplitude_mm sin(ωt + phase_rad)``; None where no gauge saw it.
    """

    amplitude_mm: float
    sd_mm: float
    phase_rad: float | None = None
    sd_phase_rad: float | None = None


def table_motion(about: Mapping[str, Any]) -> TableAmplitude | None:
    """What a capture file says of the table's motion; None where it says nothing.

    Parameters
    ----------
    about
        Content of `capture.toml`.
    """
    gauges = about.get("gauges")
    for gauge in gauges.values() if isinstance(gauges, Mapping) else ():
        if not isinstance(gauge, Mapping) or gauge.get("role") != "table":
            continue
        amplitude, sd = gauge.get("amplitude_mm"), gauge.get("sd_amplitude_mm")
        if is_positive(amplitude) and is_positive(sd) and sd < LARGEST_GAUGE_SD * amplitude:
            phase, sd_phase = gauge.get("phase_rad"), gauge.get("sd_phase_rad")
            spread = max(float(sd), LEAST_TABLE_SD * amplitude)
            if isinstance(phase, (int, float)) and is_positive(sd_phase):
                return TableAmplitude(float(amplitude), spread, float(phase), float(sd_phase))
            return TableAmplitude(float(amplitude), spread)
    stated = about.get("excitation_amplitude_mm")
    return TableAmplitude(float(stated), STATED_TABLE_SD * stated) if is_positive(stated) else None


def is_positive(value: Any) -> TypeGuard[float]:
    """Whether a value of a capture file is a number that a frequency or an amplitude can have."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < 1e9


@dataclass(frozen=True, slots=True)
class CaptureFacts:
    """What `capture.toml` says of a capture, or of the last capture of a group.

    Attributes
    ----------
    frequency_hz, excitation_amplitude_mm, exposure_s, opened_at
        None where unknown; amplitude of the table, zero to peak, as it was set.
    table
        Its motion as a gauge on it saw it, else as it was set; None where unknown.
    captures
        Names of the captures: several for a group.
    is_phase_known
        Whether a and b are in phase and in quadrature with the excitation. Where it is False they are the semi-axes of
        the orbit, and their common phase is arbitrary.
    """

    frequency_hz: float | None = None
    excitation_amplitude_mm: float | None = None
    exposure_s: float | None = None
    opened_at: str | None = None
    table: TableAmplitude | None = None
    captures: tuple[str, ...] = ()
    is_phase_known: bool = False


def capture_facts(folder: Path) -> dict[str, CaptureFacts]:
    """What the capture files of a folder state, by capture or group.

    Raises
    ------
    ConfigError
        A capture file cannot be read, or states something that cannot be; the message names file and key.
    """
    stated: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for path in sorted(folder.glob("captures/*/capture.toml")):
        about = _read_capture_file(path)
        stated.setdefault(about.get("group") or path.parent.name, []).append((path.parent.name, about))
    return {name: _joined(members) for name, members in stated.items()}


def check_captures(folder: Path, measured: Collection[str], facts: Mapping[str, CaptureFacts]) -> None:
    """Check that results are of this folder's captures; nothing is known of captures without a file.

    Parameters
    ----------
    measured
        Captures and groups that the results name.
    facts
        From `capture_facts`.

    Raises
    ------
    DataError
        Not a single one of them is.
    """
    places = {path.name for path in folder.glob("captures/*")}
    if facts and measured and not (facts.keys() | places) & set(measured):
        raise DataError(
            f"its results are of {_listed(measured)}, but its captures are {_listed(facts)}: columns were swapped, "
            "groups were renamed, or the results are another folder's; run: labdaemon process FOLDER",
            file=folder,
        )


def _listed(names: Collection[str]) -> str:
    return ", ".join(list(names)[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def _read_capture_file(path: Path) -> dict[str, Any]:
    """Content of a capture file, what counts here of a usable kind."""
    _, about = read_toml(path)
    for key in ("frequency_hz", "exposure_s", "excitation_amplitude_mm"):
        value = about.get(key)
        # A table that was not driven may be noted with an amplitude of 0.
        is_unmoved = key == "excitation_amplitude_mm" and value == 0 and not isinstance(value, bool)
        if value is not None and not is_positive(value) and not is_unmoved:
            raise ConfigError(f"must be a positive number, not {value!r}", source=path, key=key)
    if not isinstance(about.get("group", ""), str):
        raise ConfigError(f"must be text, not {about['group']!r}", source=path, key="group")
    return about


def _joined(members: list[tuple[str, Mapping[str, Any]]]) -> CaptureFacts:
    _, last = members[-1]
    numbers = {
        name: float(last[name])
        for name in ("frequency_hz", "excitation_amplitude_mm", "exposure_s")
        if isinstance(last.get(name), (int, float))
    }
    return CaptureFacts(
        **numbers,
        opened_at=str(last["opened_at"]) if "opened_at" in last else None,
        table=table_motion(last),
        captures=tuple(name for name, _ in members),
        is_phase_known=shows_phase([about for _, about in members]),
    )


def shows_phase(members: list[Mapping[str, Any]]) -> bool:
    """Whether a group's vectors are signed: coded light, or two openings of known phase that saw part cycles."""
    if any("light" in about and "light_phase_rad" in about for about in members):
        return True
    parts = [
        about
        for about in members
        if "phase_rad" in about and _part_of_cycle(about.get("frequency_hz"), about.get("exposure_s")) > PART_CYCLE
    ]
    return len(parts) > 1


def _part_of_cycle(frequency_hz: object, exposure_s: object) -> float:
    """Distance from whole cycles, in cycles; 0 where it is unknown."""
    if not isinstance(frequency_hz, (int, float)) or not isinstance(exposure_s, (int, float)):
        return 0.0
    cycles = float(frequency_hz) * float(exposure_s)
    return abs(cycles - round(cycles))
