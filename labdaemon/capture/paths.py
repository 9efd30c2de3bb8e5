"""Where a capture's files lie: a campaign's folder is a data-set folder that `labdaemon process` reproduces."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import tomli_w

from labdaemon.capture.devices import CardFile
from labdaemon.events import GaugeMotion
from labdaemon.journal.light_record import LightRecord
from labdaemon.journal.records import NO_STEP, UNKNOWN_EXPOSURE_S, CaptureRecord
from labdaemon.phase_angle import TURN, wrap_phase

LONGEST_NAME = 80  # of the card's own part: a path must stay within 255 bytes with the camera's name
_ENDING = re.compile(r"\.[a-z0-9]{1,5}")
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9._-]")


def campaign_folder(data: Path, campaign: str) -> Path:
    """The data-set folder of a campaign."""
    return data / "campaigns" / campaign


def sharp_folder(data: Path, campaign: str, sharp: str | None) -> Path:
    """Where the frames of a sharp set lie."""
    folder = campaign_folder(data, campaign) / "sharp"
    return folder / sharp if sharp else folder


def capture_folder(data: Path, capture: CaptureRecord) -> Path:
    """Where a capture's frames lie."""
    if capture.is_sharp:
        return sharp_folder(data, capture.campaign, capture.sharp)
    return campaign_folder(data, capture.campaign) / "captures" / capture.name


def frame_path(data: Path, capture: CaptureRecord, camera: str, file: CardFile) -> Path:
    """Final place of one camera's frame: sharp frames are numbered within their set from the second on."""
    ending = PurePath(file.name).suffix.lower()
    if not _ENDING.fullmatch(ending):
        ending = ".raw"  # a card's names are anything; LibRaw goes by the content
    if capture.is_sharp:
        number = f"-{capture.shot + 1}" if capture.shot else ""
        return capture_folder(data, capture) / f"{camera}{number}{ending}"
    return capture_folder(data, capture) / f"{camera}{ending}"


def set_aside_path(data: Path, campaign: str, capture: str, camera: str, name: str) -> Path:
    """Where a frame goes that belongs to no completed capture; the name is what the card makes of it."""
    root = campaign_folder(data, campaign) if campaign else data
    return root / "set_aside" / (capture or "unexpected") / f"{camera}-{_NOT_IN_NAMES.sub('_', name)[-LONGEST_NAME:]}"


def opening_phase(capture: CaptureRecord) -> float | None:
    """Excitation phase at the cameras' mean opening, radians in [0, 2π); None where it was not seen."""
    return None if capture.phase_rad is None else wrap_phase(capture.phase_rad)


def capture_toml(capture: CaptureRecord, light: LightRecord | None = None, gauges: Sequence[GaugeMotion] = ()) -> str:
    """The capture's `capture.toml`: what measuring needs to know of it, and what a person wants to."""
    phase_rad = opening_phase(capture)
    table: dict[str, Any] = {
        "frequency_hz": capture.frequency_hz,
        "exposure_s": None if capture.exposure_s == UNKNOWN_EXPOSURE_S else capture.exposure_s,
        "phase_rad": phase_rad,
        "sd_phase_rad": None if phase_rad is None else capture.sd_phase_rad or 0.0,
        "group": capture.grouped or None,
        "sharp": capture.sharp or None,
        "opened_at": capture.opened_at or None,
        "excitation_amplitude_mm": capture.amplitude_mm,
        "step": None if capture.step == NO_STEP else capture.step,
        "label": capture.label,
        **(light.file_keys if light is not None else {}),
        "cameras": _camera_phases(capture, phase_rad) or None,
        "gauges": {one.gauge: one.model_dump(exclude={"gauge"}, exclude_none=True) for one in gauges} or None,
    }
    return tomli_w.dumps({key: value for key, value in table.items() if value is not None})


def _camera_phases(capture: CaptureRecord, phase_rad: float | None) -> dict[str, dict[str, float]]:
    """Each body's own opening phase, from its measured lag behind the mean."""
    if phase_rad is None or capture.frequency_hz is None or not capture.opening_s:
        return {}
    mean_s = sum(capture.opening_s.values()) / len(capture.opening_s)
    return {
        camera: {"phase_rad": wrap_phase(phase_rad + TURN * capture.frequency_hz * (opening_s - mean_s))}
        for camera, opening_s in sorted(capture.opening_s.items())
    }


def with_opening(
    capture: CaptureRecord, opened_at: str, opening_s: Mapping[str, float], phase_rad: float | None, sd: float
) -> CaptureRecord:
    """The capture as it is once fired. A phase that was stated stays: it has a reference of its own."""
    if capture.phase_rad is not None:
        phase_rad, sd = capture.phase_rad, capture.sd_phase_rad or 0.0
    return replace(
        capture,
        state="fired",
        opened_at=opened_at,
        opening_s=dict(opening_s),
        phase_rad=phase_rad,
        sd_phase_rad=sd if phase_rad is not None else None,
    )
