"""The trigger box on its serial line: releases the shutters, times their opening, holds the shaker's enable line.

The wire is `trigger_wire`'s; its requests may be sent again without harm, so a lost or broken reply costs a retry, not
a second shot. Every call locks the wire only for one exchange: heartbeat and drop get through while a shot is awaited.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, ClassVar

from pydantic import Field

from labdaemon.capture.devices import Firing
from labdaemon.capture.lamp import LightRequest, PlayedLight
from labdaemon.errors import DeviceError, DeviceRefused, ProtocolError, TransportError, UsageError
from labdaemon.phase_angle import wrap_phase
from labdrivers.serial_line import PortSettings, SerialLine
from labdrivers.settings import read_settings, readable_settings
from labdrivers.trigger_lamp import PERIOD_WITHIN, LampControl
from labdrivers.trigger_wire import LAST_SEQUENCE, OUTPUTS, decode, elapsed_us, encode

TRIES = 3  # a line may be spoilt by a spark of the amplifier; the box does nothing twice
POLL_S = 0.01  # a shot's times are asked for until its contacts have closed
URGENT_SEQUENCE = LAST_SEQUENCE
"""Number of the drop that is sent past whatever the wire is busy with; ordinary requests never have it."""
TURN_S = 0.6
"""Longest wait for another thread's exchange before a drop opens the wire anew."""


class TriggerSettings(PortSettings):
    """``[trigger]`` of the rig file for ``driver = "box"``."""

    timeout_s: float = Field(default=0.5, gt=0, le=10)
    """Wait for one reply; three tries are made."""
    cameras: tuple[str, ...] = Field(default=("left", "right"), min_length=1, max_length=OUTPUTS)
    """Which camera's flash-sync contact is on which input, in order."""
    opening_lag_s: float = Field(default=0.06, ge=0, lt=2)
    """From release to opening, until the first shot has measured it."""
    sd_opening_s: float = Field(default=2e-4, gt=0)
    """Standard deviation of the opening by the contact: shutter curtain and contact, not the box's 10 µs."""
    hold_enable_ms: int = Field(default=1500, ge=100, le=5000)
    """How long one heartbeat holds the enable line."""


@dataclass(frozen=True, slots=True)
class BoxShot:
    """What the box knows of one release; times in µs of its clock, None for what it has not seen."""

    number: int
    state: str
    release_us: int | None
    contacts_us: tuple[int | None, ...]
    sync_us: int | None
    period_us: int | None
    now_us: int


class TriggerBox:
    """Driver of the group ``labdaemon.triggers``.

    Parameters
    ----------
    name
        Section's name in the rig file.
    settings
        The section.
    """

    SETTINGS: ClassVar[frozenset[str]] = frozenset(TriggerSettings.model_fields)
    holds_enable: ClassVar[bool] = True
    plays_light: ClassVar[bool] = True
    reopens: ClassVar[bool] = True
    """`drop_enable` opens a broken wire anew by itself."""

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        self.name = name
        self._settings = read_settings(TriggerSettings, settings, key=name, ignore=frozenset({"driver"}))
        self._line = SerialLine(name, self._settings, raise_lines=False)
        self._lock = threading.Lock()
        self._sequence = 0
        self._lag_s = self._settings.opening_lag_s
        self._armed = False
        self._seen = 0
        self._lamp = LampControl(name, self._exchange)

    @classmethod
    def for_stopping(cls, name: str, settings: Mapping[str, Any]) -> TriggerBox:
        """Build it from what of its section can be read: good for `drop_enable`.

        Raises
        ------
        ConfigError
            Not even its port can be read.
        """
        return cls(name, readable_settings(TriggerSettings, settings, {}))

    def connect(self) -> str:
        """Open the wire and identify. Fires nothing, raises nothing.

        Raises
        ------
        TransportError
            The port does not open or the box does not answer.
        ProtocolError
            Something else than a trigger box answers.
        """
        self._armed = False
        self._lamp.forget()
        self._line.open()
        try:
            self._line.write(b"\n")
            self._line.discard()
            words = self._exchange("ID")
        except DeviceError:
            self._line.close()
            raise
        if len(words) != 4 or words[0] != "labtrigger" or not words[3].isdigit():
            self._line.close()
            raise ProtocolError(f"is no trigger box (answered {' '.join(words)!r}); check the port", device=self.name)
        if int(words[3]) < len(self._settings.cameras):
            self._line.close()
            raise DeviceRefused(
                f"has {words[3]} outputs for {len(self._settings.cameras)} cameras; shorten `cameras`", device=self.name
            )
        return " ".join(words)

    def close(self) -> None:
        """Give the wire back; the enable line drops by itself."""
        self._line.close()

    def raise_enable(self) -> None:
        """Raise the shaker's enable line: the caller has seen the shaker's output off just before."""
        self._exchange(f"EN {self._settings.hold_enable_ms}")

    def heartbeat(self) -> None:
        """Hold the enable line a while longer. Never raises a line that is down.

        Raises
        ------
        DeviceRefused
            The line is down: a heartbeat came too late, the box restarted, or it was dropped.
        """
        if self._exchange(f"HB {self._settings.hold_enable_ms}") != ("1",):
            raise DeviceRefused(
                "the shaker's enable line is down; bring the shaker's output to rest, then raise it again",
                device=self.name,
            )

    def drop_enable(self) -> None:
        """Drop the enable line now, past whatever the wire is busy with; only `raise_enable` brings it back.

        Opens the wire where it is closed or broken, and once more where the box does not answer.

        Raises
        ------
        TransportError, ProtocolError
            The box does not answer. Without heartbeats it drops the line by itself.
        DeviceRefused
            It says that the line does not drop.
        """
        try:
            self._drop()
        except (TransportError, ProtocolError):
            self._armed = False
            self._line.open()  # ends what another thread waits for on the old wire
            self._drop()

    def _drop(self) -> None:
        if not self._line.is_open:
            self._armed = False
            self._line.open()
        # Sent without a turn on the wire. Its own number keeps its reply from being taken for another request's.
        self._line.write(encode(">", URGENT_SEQUENCE, "DROP"))
        if not self._lock.acquire(timeout=TURN_S):
            raise TransportError("is busy with an exchange that does not end", device=self.name)
        try:
            answer = self._exchange_locked("DROP", tries=1)
        finally:
            self._lock.release()
        if answer != ("0",):
            raise DeviceRefused("enable line does not drop; use the emergency stop", device=self.name)

    def fire(self, exposure_s: float, *, frequency_hz: float | None = None, phase_rad: float | None = None) -> Firing:
        """Release all shutters once and return when they have opened.

        Parameters
        ----------
        exposure_s
            How long the release lines are held.
        frequency_hz
            Excitation, for the phase; the sync input's own period is used when it is not given.
        phase_rad
            Excitation phase wanted at the mean opening of the cameras.

        Raises
        ------
        DeviceRefused
            No sync edges although a phase was asked for, or a shot is in progress.
        """
        if not 0 < exposure_s <= 3600:
            raise UsageError(f"an exposure of {exposure_s} s cannot be held")
        hold_us = round(exposure_s * 1e6)
        request = f"FIRE {hold_us}"
        patience_s = self._lag_s + 2.5
        if phase_rad is not None:
            if frequency_hz is None or frequency_hz <= 0:
                raise UsageError("firing at a phase needs the excitation's frequency")
            turns = (phase_rad / (2 * math.pi) - self._lag_s * frequency_hz) % 1.0
            request += f" {round(turns / frequency_hz * 1e6)}"
            patience_s += 2 / frequency_hz
        shot = self._release(request, patience_s)
        return self._firing(shot, frequency_hz)

    def set_lamp(self, level: float) -> None:
        """Constant light of this brightness, 0 to 1; see `labdaemon.capture.lamp.LightCodePlayer`."""
        self._lamp.set_level(level)

    def fire_coded(self, exposure_s: float, light: LightRequest, *, frequency_hz: float) -> Firing:
        """Release all shutters once, and have the lamp play a code while they are open.

        Raises
        ------
        DeviceRefused
            The box does not play it; nothing was released.
        DeviceError
            The sync input has another period than the excitation; nothing was released.
        """
        if not 0 < exposure_s <= 3600 or frequency_hz <= 0:
            raise UsageError(f"no code can be played in {exposure_s} s at {frequency_hz} Hz")
        self._lamp.arm(light, exposure_s, frequency_hz)
        try:
            shot = self._release(f"FIRE {round(exposure_s * 1e6)}", self._lag_s + 2.5)
        except DeviceRefused:
            self._lamp.disarm()
            raise
        self._lamp.fired(shot.number, exposure_s)
        return self._firing(shot, frequency_hz)

    def read_played(self, timeout_s: float) -> PlayedLight:
        """What was played with the last coded shot; see `labdaemon.capture.lamp.LightCodePlayer`."""
        return self._lamp.read_played(timeout_s)

    def _release(self, request: str, patience_s: float) -> BoxShot:
        """Fire, and wait until the shutters have opened."""
        number = self._number(self._exchange(request))
        shot = self._await(number, patience_s)
        if shot is None or shot.state != "DONE":
            raise DeviceRefused("accepted a shot but never released it; power the box off and on", device=self.name)
        self._seen = max(self._seen, number) if self._armed else number
        return shot

    def wait(self, timeout_s: float) -> Firing | None:
        """Wait for a release by the external input, arming it at the first call; None when none came in time."""
        deadline = time.monotonic() + timeout_s
        if not self._armed:
            self._seen = self._number(self._exchange("ARM 1000000"))
            self._armed = True
        while True:
            shot = self._ask_shot(self._seen + 1)
            if shot is not None and shot.state == "DONE":
                self._seen = shot.number
                return self._firing(shot, None)
            if time.monotonic() >= deadline and (shot is None or shot.state == "WAIT"):
                return None
            time.sleep(POLL_S)

    def _await(self, number: int, patience_s: float) -> BoxShot | None:
        deadline = time.monotonic() + patience_s
        while True:
            shot = self._ask_shot(number)
            if (shot is not None and shot.state == "DONE") or time.monotonic() >= deadline:
                return shot
            time.sleep(POLL_S)

    def _ask_shot(self, number: int) -> BoxShot | None:
        try:
            words = self._exchange(f"SHOT {number}")
        except DeviceRefused as exc:
            if "UNKNOWN" in str(exc):
                return None
            raise
        try:
            if len(words) != 6 + OUTPUTS or words[1] not in ("WAIT", "OPEN", "DONE"):
                raise ValueError
            times = [None if word == "-" else int(word) for word in words[2:-1]]
            return BoxShot(
                int(words[0]), words[1], times[0], tuple(times[1 : 1 + OUTPUTS]), times[-2], times[-1], int(words[-1])
            )
        except ValueError:
            raise ProtocolError(f"describes a shot as {' '.join(words)!r}", device=self.name) from None

    def _firing(self, shot: BoxShot, frequency_hz: float | None) -> Firing:
        """From the box's clock to the host's and to the excitation's phase."""
        if shot.release_us is None:
            raise ProtocolError("reports a shot without its release", device=self.name)
        opening_s = {
            camera: elapsed_us(contact, shot.release_us) * 1e-6
            for camera, contact in zip(self._settings.cameras, shot.contacts_us, strict=False)
            if contact is not None
        }
        if opening_s:
            self._lag_s = sum(opening_s.values()) / len(opening_s)
        age_s = elapsed_us(shot.now_us, shot.release_us) * 1e-6 - self._lag_s
        opened_at = datetime.now(UTC) - timedelta(seconds=age_s)
        seen_hz = 1e6 / shot.period_us if shot.period_us else None
        if seen_hz is not None and (frequency_hz is None or abs(seen_hz / frequency_hz - 1) < PERIOD_WITHIN):
            # By the clock that the times are of: a resonator may be off by half a per cent, 2° of a cycle.
            frequency_hz = seen_hz
        if shot.sync_us is None or frequency_hz is None or not opening_s:
            return Firing(opened_at, opening_s)
        after_sync_s = elapsed_us(shot.release_us, shot.sync_us) * 1e-6 + self._lag_s
        omega = 2 * math.pi * frequency_hz
        sd_s = self._settings.sd_opening_s / math.sqrt(len(opening_s))
        return Firing(opened_at, opening_s, wrap_phase(omega * after_sync_s), omega * sd_s)

    def _number(self, words: tuple[str, ...]) -> int:
        if len(words) != 1 or not words[0].isdigit():
            raise ProtocolError(f"answered {' '.join(words)!r} where a shot's number belongs", device=self.name)
        return int(words[0])

    def _exchange(self, request: str) -> tuple[str, ...]:
        """One request and its reply's values; sent up to three times, served once."""
        with self._lock:
            return self._exchange_locked(request)

    def _exchange_locked(self, request: str, tries: int = TRIES) -> tuple[str, ...]:
        self._sequence = self._sequence % (LAST_SEQUENCE - 1) + 1
        line = encode(">", self._sequence, request)
        fault: DeviceError = TransportError(f"does not answer {request!r}", device=self.name)
        for _ in range(tries):
            self._line.write(line)
            try:
                words = self._reply(request)
            except (TransportError, ProtocolError) as exc:
                fault = exc
                if not self._line.is_open:
                    break
                self._line.discard(limit_s=0.1)
                continue
            if words[:1] == ("OK",):
                return words[1:]
            if words[:1] == ("ERR",):
                raise DeviceRefused(f"refused {request!r}: {' '.join(words[1:])}", device=self.name)
            fault = ProtocolError(f"answered {' '.join(words)!r} to {request!r}", device=self.name)
        raise fault

    def _reply(self, request: str) -> tuple[str, ...]:
        deadline = time.monotonic() + self._settings.timeout_s
        rubbish = 0
        while True:
            try:
                frame = decode("<", self._line.read_line(deadline))
            except TransportError:
                if rubbish:
                    raise ProtocolError(
                        f"answers {request!r} with rubbish; check baud rate and wiring", device=self.name
                    ) from None
                raise
            if frame is not None and frame.sequence == self._sequence:
                return frame.words
            rubbish += frame is None  # a frame with another number is only late
            if rubbish > 100:
                raise ProtocolError("babbles; check baud rate and that it is this device", device=self.name)
