"""A displacement gauge (or accelerometer) that streams: one reading a sample, as text lines or binary records.

Text: ``+0001.2345`` and CR LF, in the gauge's unit. Binary: ``A5 5A``, a little-endian 32-bit count of 10⁻⁴ of the
unit, and the low byte of the sum of those four. Readings carry white noise and the converter's steps.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labdrivers.sim.faults import Faults
from labdrivers.sim.wire import WireDevice

FAULTS = {
    "silent": "sends nothing more",
    "stuck": "repeats its last reading for ever",
    "rubbish": "sends noise instead of readings",
    "hang_up": "cuts the connection",
    "drops": "loses every tenth reading",
    "slow": "sends at half its rate",
    "out_of_range": "sends `----.----` as gauges do when the target is out of range",
    "drifting_gain": "reads `value` times too much (default 1.2)",
    "noisy": "has `value` units of noise (default 1)",
    "clips": "reads no further than `value` units from zero (default 0.5)",
    "spikes": "one reading in a hundred is off by `value` units (default 50)",
    "no_line_end": "sends digits without ever ending a line",
    "half_lines": "loses the second half of every line",
    "bursts": "sends nothing for `value` seconds at a time (default 0.3), then all at once",
}
BLOCK_S = 0.02
Probe = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""What the gauge points at: rig's clock (n,) in, value in its unit (n,) out."""


class GaugeDevice(WireDevice):
    """The gauge; it streams while a host listens.

    Parameters
    ----------
    probe
        What it points at.
    rate_hz
        Readings a second.
    noise
        Standard deviation of a reading.
    form
        Text lines or binary records.
    """

    def __init__(
        self,
        probe: Probe,
        *,
        rate_hz: float = 500.0,
        noise: float = 0.002,
        form: Literal["line", "binary"] = "line",
        clock: Callable[[], float] = time.monotonic,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.faults = Faults(FAULTS)
        self._probe, self._rate_hz, self._noise, self._form, self._clock = probe, rate_hz, noise, form, clock
        self._random = np.random.default_rng(seed)
        self._listening = threading.Event()
        self._off = threading.Event()
        self._last = 0.0
        threading.Thread(target=self._stream, name="gauge", daemon=True).start()

    def attached(self) -> None:
        """A host listens."""
        self._listening.set()

    def detached(self) -> None:
        """The port was closed: stop streaming."""
        self._listening.clear()

    def receive(self, data: bytes) -> None:
        """It takes no commands."""

    def shut_down(self) -> None:
        """Power off."""
        self._off.set()
        self._listening.set()

    def _stream(self) -> None:
        while not self._off.is_set():
            self._listening.wait()
            start, sent = self._clock(), 0
            while self._listening.is_set() and not self._off.is_set():
                time.sleep(self.faults.value("bursts", 0.3) if self.faults.is_on("bursts") else BLOCK_S)
                due = int((self._clock() - start) * self._rate_hz)
                if due > sent:
                    self._send_block(start + (np.arange(sent, due) + 1) / self._rate_hz, sent)
                    sent = due

    def _send_block(self, t: NDArray[np.float64], first: int) -> None:
        values = self._probe(t)
        if self.faults.is_on("drifting_gain"):
            values = values * self.faults.value("drifting_gain", 1.2)
        noise = self.faults.value("noisy", 1.0) if self.faults.is_on("noisy") else self._noise
        values = values + self._random.normal(0.0, noise, values.size)
        if self.faults.is_on("clips"):
            most = self.faults.value("clips", 0.5)
            values = np.clip(values, -most, most)
        if self.faults.is_on("spikes"):
            values = values + (self._random.random(values.size) < 0.01) * self.faults.value("spikes", 50.0)
        if self.faults.is_on("stuck"):
            values = np.full(values.size, self._last)
        self._last = float(values[-1])
        numbers = first + np.arange(values.size)
        if self.faults.is_on("drops"):
            values = values[numbers % 10 != 0]
        elif self.faults.is_on("slow"):
            values = values[numbers % 2 == 0]
        if self.faults.strike("hang_up"):
            self.hang_up()
        elif self.faults.is_on("rubbish"):
            self.send(self._random.bytes(8 * values.size))
        elif self.faults.is_on("no_line_end"):
            self.send(b"0" * 8 * values.size)
        elif not self.faults.is_on("silent"):
            self.send(b"".join(map(self._record, values)))

    def _record(self, value: float) -> bytes:
        if self._form == "line" and self.faults.is_on("half_lines"):
            return f"{value:+010.4f}"[:4].encode() + b"\n" * int(self._random.random() < 0.5)
        if self._form == "line":
            return b"----.----\r\n" if self.faults.is_on("out_of_range") else f"{value:+010.4f}\r\n".encode()
        count = struct.pack("<i", round(value * 1e4))
        return b"\xa5\x5a" + count + bytes([sum(count) & 0xFF])
