"""A driver for a displacement laser: one ASCII line per sample, ``D+01.2345``, millimetres, 1000 lines per second."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import serial
from numpy.typing import NDArray

from labdaemon.capture.devices import GaugeReading
from labdaemon.errors import ProtocolError, TransportError

RATE_HZ = 1000.0


class MyLaser:
    """Driver of the group ``labdaemon.gauges``.

    Parameters
    ----------
    name
        Name of the gauge in the rig file.
    settings
        Its section: ``port``, ``role``, ``unit``.
    """

    SETTINGS = frozenset({"port", "role", "unit", "name", "driver"})

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self.unit = str(settings.get("unit", "mm"))
        self.role = str(settings["role"])
        self._port = str(settings["port"])
        self._serial: serial.SerialBase | None = None

    def connect(self) -> str:
        """Open the port and wait for one sample."""
        try:
            self._serial = serial.serial_for_url(self._port, baudrate=115200, timeout=2.0)
        except serial.SerialException as exc:
            raise TransportError(f"cannot open {self._port} ({exc}); check the cable", device=self.name) from exc
        self._samples(1)
        return f"laser on {self._port}"

    def read(self, frequency_hz: float, *, duration_s: float) -> GaugeReading:
        """Amplitude at the excitation frequency over the next `duration_s` seconds."""
        y = self._samples(max(int(duration_s * RATE_HZ), 8))
        amplitude, sd, phase = fit_sine(y, frequency_hz)
        half = len(y) // 2
        first, second = fit_sine(y[:half], frequency_hz)[0], fit_sine(y[half:], frequency_hz)[0]
        cycles = max(half / RATE_HZ * frequency_hz, 1e-9)
        change = abs(second - first) / max(amplitude, 1e-12) / cycles
        return GaugeReading(amplitude, sd, phase, change)

    def close(self) -> None:
        """Give the port back."""
        if self._serial is not None:
            self._serial.close()

    def _samples(self, count: int) -> NDArray[np.float64]:
        """The next samples, from a fresh line on."""
        if self._serial is None:
            raise TransportError("is not connected", device=self.name)
        deadline = time.monotonic() + 2.0 + 2.0 * count / RATE_HZ
        self._serial.reset_input_buffer()
        self._serial.readline()  # probably a part of a line
        values: list[float] = []
        while len(values) < count:
            if time.monotonic() > deadline:
                raise TransportError(f"only {len(values)} of {count} samples came; is it on?", device=self.name)
            line = self._serial.readline()
            try:
                values.append(float(line.removeprefix(b"D")))
            except ValueError:
                raise ProtocolError(f"{line[:40]!r} is no sample; expected D+01.2345", device=self.name) from None
        return np.array(values)


def fit_sine(y: NDArray[np.float64], frequency_hz: float) -> tuple[float, float, float]:
    """Amplitude, its sd, and phase by the three-parameter least-squares fit of IEEE 1057."""
    angle = 2 * np.pi * frequency_hz * np.arange(len(y)) / RATE_HZ
    design = np.column_stack((np.sin(angle), np.cos(angle), np.ones_like(angle)))
    solution, *_ = np.linalg.lstsq(design, y, rcond=None)
    residual = y - design @ solution
    variance = float(residual @ residual) / max(len(y) - 3, 1)
    amplitude = float(np.hypot(solution[0], solution[1]))
    return amplitude, float(np.sqrt(2 * variance / len(y))), float(np.arctan2(solution[1], solution[0]))
