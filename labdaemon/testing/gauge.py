"""A gauge in memory: it reads what the fake world does."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labdaemon.capture.abilities import GaugeRecord
from labdaemon.capture.devices import GaugeReading, SineReading

if TYPE_CHECKING:
    from labdaemon.testing.rig import FakeWorld

RECORD_READINGS = 200
"""Readings in a fake gauge's record, however long it is."""


@dataclass(slots=True)
class FakeGauge:
    """Reads the world's table or structure, without noise to speak of.

    Attributes
    ----------
    gain
        Its reading over the truth.
    third
        Third harmonic of what it sees, over the fundamental.
    """

    world: FakeWorld
    name: str
    role: str
    unit: str = "mm"
    gain: float = 1.0
    third: float = 0.0

    def connect(self) -> str:
        self.world.enter(self.name, "connect")
        return "fake gauge"

    def read(self, frequency_hz: float, *, duration_s: float) -> GaugeReading:
        self.world.enter(self.name, "read", 0.0)
        if self.role == "table":
            value, change = (self.world.amplitude_mm if self.world.moves() else 0.0), 0.0
        else:
            value = self.world.response_mm()
            goal = self.world.response_gain * self.world.amplitude_mm if self.world.moves() else 0.0
            change = abs(goal - value) / max(value, 1e-9) * 2.0 * math.pi * self.world.damping_ratio
        return GaugeReading(self.gain * value, 1e-4, 0.0, change)

    def find_sine(self, *, duration_s: float) -> SineReading:
        self.world.enter(self.name, "find_sine", 0.0)
        value = self.gain * (self.world.amplitude_mm if self.world.moves() else 0.0)
        return SineReading(self.world.frequency_hz, 1e-3, value, 1e-4, value > 0.0)

    def record(self, *, start_s: float, duration_s: float) -> GaugeRecord:
        self.world.enter(self.name, "record", 0.0)
        amplitude = self.world.amplitude_mm if self.world.moves() else 0.0
        value = self.gain * (amplitude if self.role == "table" else self.world.response_mm())
        t_s = np.arange(RECORD_READINGS) * duration_s / RECORD_READINGS
        angle = 2.0 * math.pi * self.world.frequency_hz * (t_s + start_s)
        ripple = 1e-4 * np.sin(1e3 * np.arange(RECORD_READINGS) ** 2)  # what a real gauge has as noise
        return GaugeRecord(t_s, value * np.sin(angle) + self.third * value * np.sin(3.0 * angle) + ripple, 1e-3)

    def close(self) -> None:
        self.world.enter(self.name, "close")
