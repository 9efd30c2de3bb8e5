"""What is known of each capture of a data-set folder: excitation, time, and whether it shows the phase."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labdaemon.errors import ConfigError, DataError
from labdaemon.tomlfile import read_toml

PART_CYCLE = 0.05
"""Cycles from which an exposure is not whole any more, as for the flag part_cycles."""


@dataclass(frozen=True, slots=True)
class CaptureFacts:
    """What `capture.toml` says of a capture, or of the last capture of a group.

    Attributes
    ----------
    frequency_hz, excitation_amplitude_mm, exposure_s, opened_at
        None where unknown; amplitude of the table, zero to peak.
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
    captures: tuple[str, ...] = ()
    is_phase_known: bool = False


def capture_facts(folder: Path) -> dict[str, CaptureFacts]:
    """What the capture files of a folder state, by capture or group.

    Raises
    ------
    DataError
        A capture file cannot be read.
    """
    stated: dict[str, list[tuple[str, Mapping[str, Any]]]] = {}
    for path in sorted(folder.glob("captures/*/capture.toml")):
        try:
            _, about = read_toml(path)
        except ConfigError as exc:
            raise DataError(f"cannot be read ({exc})", file=path) from None
        stated.setdefault(str(about.get("group") or path.parent.name), []).append((path.parent.name, about))
    return {name: _joined(members) for name, members in stated.items()}


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
        captures=tuple(name for name, _ in members),
        is_phase_known=_shows_phase([about for _, about in members]),
    )


def _shows_phase(members: list[Mapping[str, Any]]) -> bool:
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
