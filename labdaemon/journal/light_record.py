"""The light of a capture as the journal keeps it, and as `capture.toml` and events say it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from labdaemon.journal.journal import Journal, Transaction
from labdaemon.phase_angle import wrap_phase


@dataclass(frozen=True, slots=True)
class LightRecord:
    """A light code as it was played, with what the rig file says of lamp and room.

    Attributes
    ----------
    brightness
        In equal sectors of one excitation cycle, 0 to 1 in parts of the lamp's full brightness.
    cycles
        Whole cycles that were played inside the open shutters.
    phase_rad, sd_phase_rad
        Excitation phase at which the first sector begins, and its standard deviation.
    ambient
        Light that is on whenever the shutter is open, in parts of the lamp's full brightness.
    rise_s
        Time that the lamp takes from dark to full brightness.
    sd_ambient
        Standard deviation of `ambient`, None where the rig file does not say it.
    """

    brightness: tuple[float, ...]
    cycles: int
    phase_rad: float
    sd_phase_rad: float = 0.0
    ambient: float = 0.0
    rise_s: float = 0.0
    sd_ambient: float | None = None

    @property
    def capture_keys(self) -> dict[str, Any]:
        """Keys of ``capture.completed``, which `capture.toml` has, too."""
        return {
            "light": list(self.brightness),
            "light_phase_rad": wrap_phase(self.phase_rad),
            "light_cycles": self.cycles,
            "ambient": self.ambient,
            "light_rise_s": self.rise_s,
        }

    @property
    def file_keys(self) -> dict[str, Any]:
        """Keys of `capture.toml`."""
        sd = {} if self.sd_ambient is None else {"sd_ambient": self.sd_ambient}
        return {**self.capture_keys, "sd_light_phase_rad": self.sd_phase_rad, **sd}


def keep_light(write: Transaction, campaign: str, capture: str, light: LightRecord) -> None:
    """Note a capture's light, within a transaction."""
    text = json.dumps(asdict(light), allow_nan=False)
    write.execute("INSERT OR REPLACE INTO capture_lights VALUES (?, ?, ?)", campaign, capture, text)


def light_of(journal: Journal, campaign: str, capture: str) -> LightRecord | None:
    """The light code that was played during a capture; None for constant light."""
    rows = journal.read("SELECT light FROM capture_lights WHERE campaign = ? AND capture = ?", campaign, capture)
    if not rows:
        return None
    values = json.loads(rows[0][0])
    return LightRecord(**{**values, "brightness": tuple(values["brightness"])})
