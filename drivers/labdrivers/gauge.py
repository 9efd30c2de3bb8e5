"""A displacement or acceleration gauge that streams readings: the driver of the group ``labdaemon.gauges``.

A thread of its own reads all the time, so that a reading is never older than the record it belongs to. Amplitude is a
least-squares sine fit over the latest record. A gauge that fell silent, repeats itself, is out of range or sends at
a rate that differs from its setting is an error, never a number.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from labdaemon.capture.abilities import GaugeRecord
from labdaemon.capture.devices import GaugeReading, SineReading
from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError, UsageError
from labdaemon.record_range import clipped_ends
from labdaemon.sine_fit import FloatArray, change_per_cycle, fit_free_sine, fit_sine
from labdrivers.gauge_stream import LineParser, Parser, RecordParser
from labdrivers.reading_times import ReadingTimes
from labdrivers.serial_line import PortSettings, SerialLine
from labdrivers.settings import read_settings

KEEP_S = 60.0  # what is kept of the readings; a longer record is refused
FIRST_READING_S = 2.0  # a gauge that has sent nothing by then is silent, unplugged or set to another rate
STUCK_READINGS = 100  # equal to the last digit: noise alone would change it
RATE_TOLERANCE = 0.05  # timers in software drift by a per cent or two
MOST_BAD = 0.03
"""Share of a record that may be without a number, or outliers."""
OUTLIER = 10.0
"""Residuals beyond this many times their median size (6.7 standard deviations) are no noise."""


class GaugeSettings(PortSettings):
    """One ``[[gauge]]`` of the rig file."""

    role: Literal["table", "response"] = "table"
    unit: str = "mm"
    rate_hz: float = Field(default=500.0, gt=0)
    format: Literal["line", "binary"] = "line"
    column: int = Field(default=0, ge=0)
    separator: str = ","
    marker: str = "a55a"
    """Binary: first bytes of a record, hexadecimal."""
    record: str = "<i"
    """Binary: `struct` format of the value."""
    checksum: bool = True
    """Binary: a byte with the sum of the value's bytes follows."""
    scale: float = 1.0
    """Reading × scale is the value in `unit`."""
    stale_s: float = Field(default=0.5, gt=0)
    """A gauge silent for longer is an error."""
    delay_s: float = Field(default=0.0, ge=0, le=10)
    """From a reading to its arrival here: the gauge's own filter, and the wire."""
    sd_delay_s: float = Field(default=0.01, ge=0, le=10)
    """Its standard deviation; phases against the excitation are known no better."""

    @field_validator("marker")
    @classmethod
    def _hexadecimal(cls, marker: str) -> str:
        if not bytes.fromhex(marker):
            raise ValueError("a marker of at least one byte is needed, in hexadecimal")
        return marker

    @field_validator("record")
    @classmethod
    def _one_value(cls, record: str) -> str:
        try:
            count = len(struct.unpack(record, bytes(struct.calcsize(record))))
        except struct.error as exc:
            raise ValueError(f"no struct format: {exc}") from None
        if count != 1:
            raise ValueError("a format of exactly one value is needed")
        return record


class LineGauge:
    """One gauge.

    Parameters
    ----------
    name
        Its name in the rig file.
    settings
        Its section.
    """

    SETTINGS: ClassVar[frozenset[str]] = frozenset(GaugeSettings.model_fields)

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self._settings = read_settings(GaugeSettings, settings, key=name, ignore=frozenset({"driver", "name"}))
        self.unit: str = self._settings.unit
        self.role: str = self._settings.role
        self._line = SerialLine(name, self._settings)
        self._news = threading.Condition()
        self._values: deque[float] = deque(maxlen=int(KEEP_S * self._settings.rate_hz))
        self._times = ReadingTimes(self._settings.rate_hz, KEEP_S)
        self._total = 0
        self._first_at = self._last_at = 0.0
        self._fault: DeviceError | None = None
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def connect(self) -> str:
        """Open the stream and wait for its first readings.

        Raises
        ------
        TransportError
            The port does not open, or nothing comes.
        ProtocolError
            What comes are no readings.
        """
        self.close()
        self._line.open()
        with self._news:  # another thread may be reading the record of before
            self._values.clear()
            self._times.clear()
            self._total, self._fault = 0, None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, args=(self._closing,), name=self.name, daemon=True)
        self._thread.start()
        deadline = time.monotonic() + FIRST_READING_S
        try:
            with self._news:
                while self._total < 10:
                    self._raise_fault()
                    left = deadline - time.monotonic()
                    if left <= 0:
                        raise TransportError(
                            f"sends no readings on {self._settings.port}; check power, cable and baud rate",
                            device=self.name,
                        )
                    self._news.wait(left)
                if np.isnan(list(self._values)).all():
                    raise ProtocolError("sends lines without numbers; check format and baud rate", device=self.name)
        except DeviceError:
            self.close()
            raise
        return f"{self._settings.format} gauge on {self._settings.port}, {self._settings.rate_hz:g} readings/s"

    def read(self, frequency_hz: float, *, duration_s: float) -> GaugeReading:
        """Amplitude over the latest `duration_s` seconds; waits for that much data if need be.

        Parameters
        ----------
        frequency_hz
            Of the sine to look for.
        duration_s
            At least one cycle.

        Raises
        ------
        TransportError
            The gauge fell silent or its connection broke.
        ProtocolError
            Rubbish, or another rate than `rate_hz`.
        DeviceRefused
            Out of range, or stuck on one reading.
        """
        count = round(duration_s * self._settings.rate_hz)
        if frequency_hz <= 0 or duration_s * frequency_hz < 1 or count < 8 or duration_s > KEEP_S:
            raise UsageError(f"{duration_s} s of {frequency_hz} Hz is no record to fit a sine to")
        y = self._record(count) * self._settings.scale
        self._judge(y)
        usable = np.isfinite(y)
        t = np.arange(y.size) / self._settings.rate_hz
        residual = np.full(y.size, np.inf)
        residual[usable] = np.abs(y[usable] - fit_sine(t[usable], y[usable], frequency_hz).at(t[usable], frequency_hz))
        usable &= residual <= OUTLIER * max(float(np.median(residual[usable])), 1e-12)
        self._check_share(usable, "outliers: check its cable and what it looks at")
        sine = fit_sine(t[usable], y[usable], frequency_hz)
        change = change_per_cycle(t[usable], y[usable], frequency_hz)
        return GaugeReading(sine.amplitude, sine.sd, sine.phase_rad, change)

    def find_sine(self, *, duration_s: float) -> SineReading:
        """Frequency and amplitude of the strongest sine over the latest `duration_s` seconds.

        Parameters
        ----------
        duration_s
            Waited for if need be; at most a minute. What makes less than 1.5 cycles in it is drift.

        Raises
        ------
        TransportError, ProtocolError, DeviceRefused
            As `read`.
        """
        count = round(duration_s * self._settings.rate_hz)
        if count < 16 or duration_s > KEEP_S:
            raise UsageError(f"{duration_s} s are no record to look for a sine in")
        y = self._record(count) * self._settings.scale
        self._judge(y)
        # Missing numbers and spikes are bridged: the search needs even spacing, and `_judge` refuses many of them.
        t, usable = np.arange(y.size) / self._settings.rate_hz, np.isfinite(y)
        free = fit_free_sine(t, np.interp(t, t[usable], y[usable]))
        residual = np.abs(np.where(usable, y, np.inf) - free.sine.at(t, free.frequency_hz))
        spikes = residual > OUTLIER * max(float(np.median(residual)), 1e-12)
        if (usable & spikes).any():
            self._check_share(~spikes, "outliers: check its cable and what it looks at")
            free = fit_free_sine(t, np.interp(t, t[~spikes], y[~spikes]))
        return SineReading(
            free.frequency_hz, free.sd_frequency_hz, free.sine.amplitude, free.sine.sd, free.is_significant
        )

    def record(self, *, start_s: float, duration_s: float) -> GaugeRecord:
        """Readings of a window, as they came; see `labdaemon.capture.abilities.RecordSource`.

        Raises
        ------
        TransportError
            The gauge fell silent before the window's end, or its connection broke.
        ProtocolError
            Another rate than `rate_hz`.
        """
        s = self._settings
        end_s = start_s + duration_s + s.delay_s
        with self._news:
            while True:
                self._check_stream(max(end_s, time.monotonic()) + s.stale_s)
                if self._last_at >= end_s:
                    break
                self._news.wait(0.05)
            self._check_rate()
            values = np.array(self._values) * s.scale
            t_s = self._times.of_latest(values.size) - s.delay_s - start_s
        within = (t_s >= 0) & (t_s < duration_s)
        return GaugeRecord(t_s[within], values[within], s.sd_delay_s)

    def close(self) -> None:
        """Stop reading and give the wire back."""
        self._closing.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(2.0)
        self._line.close()

    def _listen(self, closing: threading.Event) -> None:
        parser = self._parser()
        while not closing.is_set():
            try:
                values = parser.feed(self._line.read_block(4096))
            except DeviceError as exc:
                with self._news:
                    if not closing.is_set():
                        self._fault = exc
                    self._news.notify_all()
                return
            if not values:
                continue
            now = time.monotonic()
            with self._news:
                if self._total == 0:
                    self._first_at = now
                self._values.extend(values)
                self._total += len(values)
                self._times.note(self._total, now)
                self._last_at = now
                self._news.notify_all()

    def _parser(self) -> Parser:
        s = self._settings
        if s.format == "line":
            return LineParser(column=s.column, separator=s.separator)
        return RecordParser(marker=bytes.fromhex(s.marker), form=s.record, checksum=s.checksum)

    def _record(self, count: int) -> FloatArray:
        """Latest `count` readings, waited for."""
        deadline = time.monotonic() + 1.5 * count / self._settings.rate_hz + 1.0
        with self._news:
            while True:
                self._check_stream(deadline)
                if len(self._values) >= count:
                    break
                self._news.wait(0.05)
            self._check_rate()
            return np.array(self._values)[-count:]

    def _check_stream(self, deadline_s: float) -> None:
        """Refuse to wait for a gauge that does not send."""
        if self._thread is None:
            raise TransportError("not connected; connect first", device=self.name)
        self._raise_fault()
        now = time.monotonic()
        if now - self._last_at > self._settings.stale_s or now > deadline_s:
            raise TransportError(
                f"sends no readings since {now - self._last_at:.1f} s; check its power and cable", device=self.name
            )

    def _check_rate(self) -> None:
        lasted = self._last_at - self._first_at
        if lasted < 1.0:
            return
        rate_hz = self._total / lasted
        if abs(rate_hz / self._settings.rate_hz - 1) > RATE_TOLERANCE + 0.05 / lasted:
            raise ProtocolError(
                f"sends {rate_hz:.0f} readings/s, not {self._settings.rate_hz:g}; set rate_hz to what it does",
                device=self.name,
            )

    def _judge(self, y: FloatArray) -> None:
        """Refuse records that no sound gauge sends."""
        usable = np.isfinite(y)
        self._check_share(usable, "no numbers: target out of range, or wrong format")
        values = y[usable]
        low, high = float(values.min()), float(values.max())
        if values.size >= STUCK_READINGS and low == high:
            raise DeviceRefused(f"stuck at {low:g} {self.unit}; check its target and cable", device=self.name)
        if clipped := clipped_ends(values):
            raise DeviceRefused(
                f"clipped at {' and '.join(f'{end:g}' for end in clipped)} {self.unit}: beyond its range; move it or "
                "choose a larger range",
                device=self.name,
            )

    def _check_share(self, usable: NDArray[np.bool_], complaint: str) -> None:
        bad = 1 - float(usable.mean())
        if bad > MOST_BAD:
            raise DeviceRefused(f"{bad:.0%} of its record are {complaint}", device=self.name)

    def _raise_fault(self) -> None:
        if self._fault is not None:
            raise self._fault
