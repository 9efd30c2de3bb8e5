"""A shaker table behind a function generator or vibration controller that speaks SCPI.

The driver trusts nothing that it has not read back: a set-point counts when the controller reports it and its error
queue is empty, rest counts when the output says that it is off. It ramps, never jumps, and checks the table's limits
itself, whatever the caller checked before.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

from labdaemon.capture.devices import ShakerState
from labdaemon.errors import ConfigError, DeviceError, DeviceRefused, LimitError, ProtocolError, TransportError
from labdaemon.guardian.recipe import StopRecipe
from labdrivers.drive_table import DriveTable, read_drive_csv
from labdrivers.scpi_commands import DIALECTS, LEVELS, ScpiCommands
from labdrivers.scpi_limits import check_excitation, check_level
from labdrivers.scpi_link import ScpiLink
from labdrivers.scpi_recipe import stop_recipe
from labdrivers.scpi_settings import STOPPING, ShakerSettings
from labdrivers.serial_line import SerialLine
from labdrivers.settings import read_settings, readable_settings

RAMP_TICK_S = 0.05  # steps so short that the table does not jump
STOP_TRIES = 3  # one broken answer must not keep the output on
STOP_ANSWER_S = 0.5
"""A controller that is silent for so long during a stop is stopped hard, on a wire opened anew."""
STOP_RAMP_S = 1.5
"""A soft stop takes this long at most, however far the table moves."""
SAME_FREQUENCY = 1.02
"""A correction found at one frequency holds within this ratio of it."""
TRIM_RANGE = (0.25, 4.0)
"""A table that moves less or more than this times its calibration is broken, not off."""


class ScpiShaker:
    """Driver of the group ``labdaemon.shakers``.

    Parameters
    ----------
    name
        Section's name in the rig file.
    settings
        The section.

    Raises
    ------
    ConfigError
        A key is wrong, or the controller cannot switch off and there is no enable line.
    """

    SETTINGS: ClassVar[frozenset[str]] = frozenset(ShakerSettings.model_fields)
    reopens: ClassVar[bool] = True
    """`stop_now` opens a broken wire anew by itself."""

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self._settings = read_settings(ShakerSettings, settings, key=name, ignore=frozenset({"driver"}))
        base = DIALECTS[self._settings.dialect].model_dump()
        self._commands = read_settings(ScpiCommands, {**base, **self._settings.commands}, key=f"{name}.commands")
        if not self._commands.can_switch_off and not self._settings.enable_line:
            raise ConfigError(
                "this controller has no output-off, so it may not run unattended without the amplifier's enable line; "
                "wire it to the trigger box and set enable_line = true",
                key=f"{name}.enable_line",
            )
        self._table = self._read_table() if self._commands.in_volts else None
        self._line = SerialLine(name, self._settings)
        self._link = ScpiLink(self._line, self._commands)
        self._trim, self._trim_at_hz = 1.0, 0.0
        self._halt = threading.Event()
        self._sent: tuple[float, float] | None = None
        """Frequency and amplitude (Hz, mm) that went out last while the output was on; None while unknown."""

    @classmethod
    def for_stopping(cls, name: str, settings: Mapping[str, Any]) -> ScpiShaker:
        """Build it from what of its section can be read: good for `stop_now` and `state`, never for `set`.

        Raises
        ------
        ConfigError
            Not even its port can be read.
        """
        needed = {key: value for key, value in settings.items() if key not in STOPPING}
        readable = readable_settings(ShakerSettings, needed, STOPPING)
        for without in ((), ("commands",), ("commands", "dialect")):
            try:
                return cls(name, {key: value for key, value in readable.items() if key not in without})
            except ConfigError as exc:
                fault = exc
        raise fault

    def _read_table(self) -> DriveTable:
        file = self._settings.calibration
        points = self._settings.drive if file is None else read_drive_csv(file)
        if not points:
            raise ConfigError(
                "levels in volts need a calibration; add [[shaker.drive]] points or a calibration file",
                key=f"{self.name}.drive",
            )
        return DriveTable(points, key=f"{self.name}.drive")

    @property
    def can_switch_off(self) -> bool:
        """Whether `stop` ends with an output that is off rather than at its lowest level."""
        return self._commands.can_switch_off

    @property
    def reports_amplifier(self) -> bool:
        """Whether `state` says what the amplifier does, which can prove its enable line."""
        return bool(self._commands.get_amplifier)

    def connect(self) -> str:
        """Open the wire and identify. Changes nothing on the controller: a moving table continues."""
        self._line.open()
        self._sent = None
        try:
            return self._link.identify()
        except DeviceError:
            self._line.close()
            raise

    def close(self) -> None:
        """Give the wire back, whatever the table does."""
        self._halt.set()
        self._line.close()

    def set(self, frequency_hz: float, amplitude_mm: float) -> None:
        """Ramp to a sine (amplitude of the table, zero to peak) and confirm it.

        Raises
        ------
        LimitError
            Beyond the table, or outside its calibration. Nothing was sent.
        DeviceRefused
            The controller did not take it, or `stop`/`stop_now` came from another thread meanwhile.
        TransportError, ProtocolError
            The wire or the answers failed; the table may be moving: stop it.
        """
        self._halt.clear()
        self.check(frequency_hz, amplitude_mm)
        if self._trims_elsewhere(frequency_hz):
            self._trim, self._trim_at_hz = 1.0, 0.0
        now = self.state()
        if now.running and math.isnan(now.amplitude_mm):
            self._switch_off()  # running at a frequency without calibration: its amplitude is unknown
            now = ShakerState(False, frequency_hz, 0.0)
        if now.running and not self._near(now.frequency_hz, frequency_hz):
            self._ramp(now, now.frequency_hz, self._lowest_mm(now.frequency_hz))
            self._send_frequency(frequency_hz)
            now = ShakerState(True, frequency_hz, self._lowest_mm(frequency_hz))
        elif not now.running:
            self._prepare(frequency_hz)
            now = ShakerState(True, frequency_hz, self._lowest_mm(frequency_hz))
            if self._commands.output_on:
                with self._link.exclusive():  # a stop from another thread comes before this or switches off after it
                    self._pass_gate()
                    self._link.write(self._commands.output_on)
        self._ramp(now, frequency_hz, amplitude_mm)
        self._confirm(frequency_hz, amplitude_mm)

    def trim(self, factor: float) -> None:
        """Correct the calibration at the present frequency: the table moves `factor` times what the drive table says.

        Takes effect with the next `set` within 2 % of this frequency; another frequency forgets it. Corrections
        multiply.

        Raises
        ------
        DeviceRefused
            The correction would leave what a sound table can need.
        """
        total = self._trim * factor
        if not TRIM_RANGE[0] <= total <= TRIM_RANGE[1]:
            raise DeviceRefused(
                f"moves {total:.3g} times what its calibration says; check gauge, amplifier gain and drive table",
                device=self.name,
            )
        self._trim, self._trim_at_hz = total, self.state().frequency_hz

    def state(self) -> ShakerState:
        """Ask the controller. The amplitude is NaN at a frequency outside the calibration."""
        frequency_hz = self._link.query_number(self._commands.get_frequency)
        level = self._link.query_number(self._commands.get_level)
        if frequency_hz <= 0:
            raise ProtocolError(f"reports a frequency of {frequency_hz:g} Hz", device=self.name)
        if self._commands.get_output:
            running = self._link.query_switch(self._commands.get_output)
        else:
            running = level > self._lowest_level * 1.01
        amplifier_on = self._link.query_switch(self._commands.get_amplifier) if self.reports_amplifier else None
        return ShakerState(running, frequency_hz, level / self._per_mm(frequency_hz), amplifier_on)

    def stop(self) -> None:
        """Ramp to rest, switch off, confirm; whatever fails on the way, the output-off is still sent.

        The first smaller level goes out at once, even while another thread waits for an answer.

        Raises
        ------
        DeviceError
            Rest is not confirmed: use `stop_now` and drop the enable line.
        """
        self._halt.set()
        with self._link.limit_waits(STOP_ANSWER_S):
            with suppress(DeviceError):  # what matters is the output, and that is switched off and confirmed below
                self._ramp_down()
            self._link.write_at_once(self._off_command)
            self._switch_off()

    def stop_now(self) -> None:
        """Output off at once, then confirm; interrupts a `set` in progress.

        Opens the wire where it is closed or broken, and once more where the controller does not answer.

        Raises
        ------
        DeviceError
            The output was not confirmed off.
        """
        self._halt.set()
        with self._link.limit_waits(STOP_ANSWER_S):
            try:
                self._off_at_once()
                self._switch_off()
            except (TransportError, ProtocolError):
                self._link.reopen()
                self._off_at_once()
                self._switch_off()

    def stop_recipe(self) -> StopRecipe | None:
        """`stop_now` as data for the guardian; None for a simulated device of this process."""
        return stop_recipe(self.name, self._settings, self._commands, self._off_command, self._lowest_level)

    @property
    def _off_command(self) -> str:
        return self._commands.output_off or self._level_command(self._lowest_level)

    def _off_at_once(self) -> None:
        """Send the output-off whatever the wire is busy with, on a wire opened anew if it is closed."""
        if not self._line.is_open:
            self._link.reopen()
        self._link.write_at_once(self._off_command)

    def _ramp_down(self) -> None:
        """From what was sent last to the lowest level; nothing where that is unknown.

        Each level is followed by a question: a setting has no answer, and only an answer shows that the wire lives.
        """
        if self._sent is None:
            return
        frequency_hz, start_mm = self._sent
        fall_mm = start_mm - self._lowest_mm(frequency_hz)
        tick_mm = max(self._settings.ramp_mm_s, fall_mm / STOP_RAMP_S) * RAMP_TICK_S
        steps = max(1, math.ceil(fall_mm / tick_mm))
        begin = time.monotonic()
        for step in range(1, steps + 1):
            level = (start_mm - fall_mm * step / steps) * self._per_mm(frequency_hz)
            if step == 1:
                self._link.write_at_once(self._level_command(level))
            else:
                self._link.write(self._level_command(level))
            self._link.query(self._commands.get_level)
            time.sleep(max(begin + step * RAMP_TICK_S - time.monotonic(), 0.0))

    def _switch_off(self) -> None:
        fault: DeviceError | None = None
        for _ in range(STOP_TRIES):
            try:
                self._link.write(self._off_command)
                if not self._still_on():
                    self._sent = None
                    return
                fault = DeviceRefused(
                    "output stays on although it was switched off; drop the enable line or use the emergency stop",
                    device=self.name,
                )
            except TransportError:
                raise  # broken or silent: another try on this wire only costs time
            except ProtocolError as exc:
                fault = exc
        assert fault is not None
        raise fault

    def _still_on(self) -> bool:
        if self._commands.get_output:
            return self._link.query_switch(self._commands.get_output)
        return self.state().running

    def _prepare(self, frequency_hz: float) -> None:
        """At rest: form, frequency and lowest level, so that switching on moves next to nothing."""
        for command in self._commands.setup:
            self._link.write(command)
        self._send_frequency(frequency_hz)
        self._send_level(frequency_hz, self._lowest_mm(frequency_hz))
        self._link.check_errors("being set up")

    def _ramp(self, start: ShakerState, frequency_hz: float, amplitude_mm: float) -> None:
        """Straight in amplitude, geometric in frequency, a small step each tick."""
        change = abs(amplitude_mm - start.amplitude_mm)
        steps = max(1, math.ceil(change / self._settings.ramp_mm_s / RAMP_TICK_S))
        moved = abs(math.log(frequency_hz / start.frequency_hz)) > 1e-9
        if moved:
            steps = max(steps, 10)
        begin = time.monotonic()
        for step in range(1, steps + 1):
            part = step / steps
            now_hz = start.frequency_hz * (frequency_hz / start.frequency_hz) ** part
            with self._link.exclusive():  # as above: no level may follow a stop
                self._pass_gate()
                if moved:
                    self._send_frequency(now_hz)
                self._send_level(now_hz, start.amplitude_mm + (amplitude_mm - start.amplitude_mm) * part)
            rest = begin + step * RAMP_TICK_S - time.monotonic()
            if step < steps and rest > 0:
                self._halt.wait(rest)

    def _confirm(self, frequency_hz: float, amplitude_mm: float) -> None:
        self._link.check_errors(f"set to {frequency_hz:g} Hz, {amplitude_mm:g} mm")
        self._pass_gate()
        now = self.state()
        tolerance = self._settings.readback_tolerance
        floor_mm = self._lowest_mm(frequency_hz)
        asked_mm = max(amplitude_mm, floor_mm)
        if (
            not (now.running or asked_mm <= floor_mm * 1.01)
            or abs(now.frequency_hz / frequency_hz - 1) > tolerance
            or abs(now.amplitude_mm - asked_mm) > tolerance * asked_mm + 0.1 * floor_mm
        ):
            self._pass_gate()
            raise DeviceRefused(
                f"set to {frequency_hz:g} Hz, {asked_mm:.4g} mm, reports {now.frequency_hz:g} Hz, "
                f"{now.amplitude_mm:.4g} mm, output {'on' if now.running else 'off'}; check its own limits",
                device=self.name,
            )

    def _pass_gate(self) -> None:
        if self._halt.is_set():
            raise DeviceRefused("stopped while it was being set", device=self.name)

    def _near(self, a_hz: float, b_hz: float) -> bool:
        return abs(math.log(a_hz / b_hz)) <= math.log(self._settings.glide_ratio)

    def _per_mm(self, frequency_hz: float) -> float:
        """Controller's level for one millimetre of the table; NaN without a calibration at this frequency."""
        mm_per_v = 1.0
        if self._table is not None:
            try:
                mm_per_v = self._table.mm_per_v(frequency_hz)
            except LimitError:  # the caller refuses a level that is not a number
                return math.nan
        return LEVELS[self._commands.level_name](frequency_hz, mm_per_v) / self._trim

    @property
    def _lowest_level(self) -> float:
        """The controller's level where ramps begin and end, in its own unit."""
        return self._settings.lowest_level_v * LEVELS[self._commands.level_name](1.0, 1.0) if self._table else 0.0

    def _lowest_mm(self, frequency_hz: float) -> float:
        return self._lowest_level / self._per_mm(frequency_hz) if self._table else self._settings.lowest_mm

    def check(self, frequency_hz: float, amplitude_mm: float) -> None:
        """Refuse what `set` would refuse: beyond the table, its calibration or the generator. Sends nothing.

        Raises
        ------
        LimitError
            It would; says what is possible.
        """
        check_excitation(self.name, self._settings, frequency_hz, amplitude_mm)
        if self._table is None:
            return
        trim = 1.0 if self._trims_elsewhere(frequency_hz) else self._trim
        level_v = amplitude_mm / (self._table.mm_per_v(frequency_hz) * trim)
        lowest_mm = self._lowest_mm(frequency_hz)
        check_level(self.name, self._settings, frequency_hz, amplitude_mm, level_v=level_v, lowest_mm=lowest_mm)

    def _trims_elsewhere(self, frequency_hz: float) -> bool:
        """Whether the correction of the drive table was found at another frequency."""
        return bool(self._trim_at_hz) and abs(math.log(frequency_hz / self._trim_at_hz)) > math.log(SAME_FREQUENCY)

    def _send_frequency(self, frequency_hz: float) -> None:
        self._link.write(self._commands.set_frequency.format(frequency_hz=frequency_hz))

    def _send_level(self, frequency_hz: float, amplitude_mm: float) -> None:
        level_mm = max(amplitude_mm, self._lowest_mm(frequency_hz))
        self._sent = frequency_hz, level_mm  # before it goes out: a stop begins below what may have arrived
        self._link.write(self._level_command(level_mm * self._per_mm(frequency_hz)))

    def _level_command(self, level: float) -> str:
        return self._commands.set_level.format(**{self._commands.level_name: level})
