"""A rig in memory, for simulated time: devices that answer at once and say how long they would have taken.

Not a stand-in for the wire simulators, which test drivers; this tests whoever calls drivers, for days at a time. The
table follows the shaker, the structure rings up behind it, cameras keep files on a card, any operation can fail.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Literal

from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.devices import (
    CameraInfo,
    CameraStatus,
    CardFile,
    Firing,
    ShakerState,
)
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.clock import Clock
from labdaemon.errors import DeviceRefused, ProtocolError, TransportError
from labdaemon.testing.gauge import FakeGauge

FaultKind = Literal["gone", "rubbish", "refused", "silent", "slow", "torn", "lost_file", "unexpected_file"]
"""Port gone; answer not in its protocol; a plain no; never an answer; one too late; a broken transfer; no file after a
release; a file of no release."""

EPOCH = datetime(2019, 1, 1)
"""A body's own clock, which was not set for years, at monotonic time 0."""

HEARTBEAT_S = 1.5
"""Without one for so long the enable line drops by itself."""


@dataclass(slots=True)
class FakeWorld:
    """What the fake devices share: the table, the structure, and time.

    Attributes
    ----------
    faults
        Queue of faults by ``device.operation``; each call of that operation takes one.
    response_gain
        Structure's amplitude over the table's, in steady state.
    stopped_at
        Monotonic times of every stop command that reached the shaker.
    deaf
        The shaker confirms every stop, and its amplifier moves the table on; the enable line is wired to nothing.
    line_wired
        Whether the enable line goes to the amplifier.
    """

    clock: Clock
    damping_ratio: float = 0.01
    response_gain: float = 3.0
    running: bool = False
    frequency_hz: float = 5.0
    amplitude_mm: float = 0.0
    changed_at: float = -1e9
    before_mm: float = 0.0
    heartbeat_at: float = -1e9
    enabled: bool = False
    deaf: bool = False
    line_wired: bool = True
    faults: dict[str, deque[FaultKind]] = field(default_factory=dict)
    faults_met: int = 0
    stopped_at: list[float] = field(default_factory=list)
    fired: int = 0
    spent_s: float = 0.0
    on_call: Callable[[str], None] = lambda operation: None

    def fail(self, operation: str, *kinds: FaultKind) -> None:
        """Let the next calls of ``device.operation`` fail like this, one each."""
        self.faults.setdefault(operation, deque()).extend(kinds)

    def enter(self, device: str, operation: str, cost_s: float = 0.01) -> FaultKind | None:
        """Every fake call starts here: lets time pass, and fails where it is to."""
        self.spent_s = cost_s
        self.on_call(f"{device}.{operation}")
        waiting = self.faults.get(f"{device}.{operation}")
        if not waiting:
            return None
        self.faults_met += 1
        kind = waiting.popleft()
        match kind:
            case "gone":
                raise TransportError("port is gone", device=device)
            case "rubbish":
                raise ProtocolError("answered rubbish", device=device)
            case "refused":
                raise DeviceRefused("said no", device=device)
            case "silent":
                self.spent_s = math.inf
                raise TransportError("never answered", device=device)
            case "slow":
                self.spent_s = 1e4
                raise TransportError("answered too late", device=device)
        return kind

    def take_spent_s(self) -> float:
        """Seconds that the last call took."""
        spent_s, self.spent_s = self.spent_s, 0.0
        return spent_s

    def is_enabled(self) -> bool:
        """Whether the enable line is up; without a heartbeat it drops for good."""
        self.enabled = self.enabled and self.clock.monotonic() - self.heartbeat_at < HEARTBEAT_S
        return self.enabled

    def moves(self) -> bool:
        """Whether the table shakes: it was set to, and the amplifier is still enabled."""
        if self.deaf:
            return self.amplitude_mm > 0
        return self.running and (not self.line_wired or self.is_enabled())

    def drive(self, running: bool, frequency_hz: float, amplitude_mm: float) -> None:
        """Change the excitation; the structure follows with its own time constant."""
        self.before_mm = self.response_mm()
        self.running, self.frequency_hz, self.amplitude_mm = running, frequency_hz, amplitude_mm
        self.changed_at = self.clock.monotonic()

    def response_mm(self) -> float:
        """Semi-amplitude of the structure now: 1/(ζ·2πf) seconds to 63 % of its way."""
        goal = self.response_gain * self.amplitude_mm if self.moves() else 0.0
        rate = self.damping_ratio * 2.0 * math.pi * self.frequency_hz
        passed_s = max(self.clock.monotonic() - self.changed_at, 0.0)
        return goal + (self.before_mm - goal) * math.exp(-rate * passed_s)


@dataclass(slots=True)
class FakeShaker:
    """A controller that does what it is asked."""

    world: FakeWorld
    name: str = "shaker"

    def connect(self) -> str:
        self.world.enter(self.name, "connect")
        return "fake shaker"

    def set(self, frequency_hz: float, amplitude_mm: float) -> None:
        self.world.enter(self.name, "set", 1.0)
        self.world.drive(True, frequency_hz, amplitude_mm)

    def state(self) -> ShakerState:
        self.world.enter(self.name, "state")
        return ShakerState(self.world.running, self.world.frequency_hz, self.world.amplitude_mm)

    def stop(self) -> None:
        self.world.enter(self.name, "stop", 0.5)
        self.world.stopped_at.append(self.world.clock.monotonic())
        self.world.drive(False, self.world.frequency_hz, self.world.amplitude_mm)

    def stop_now(self) -> None:
        self.world.enter(self.name, "stop_now")
        self.world.stopped_at.append(self.world.clock.monotonic())
        self.world.drive(False, self.world.frequency_hz, self.world.amplitude_mm)

    def close(self) -> None:
        self.world.enter(self.name, "close")


@dataclass(slots=True)
class FakeTrigger:
    """Releases all of the world's cameras."""

    world: FakeWorld
    cameras: list[FakeCamera]
    name: str = "trigger"
    outside: deque[Firing] = field(default_factory=deque)

    def edge(self, exposure_s: float) -> None:
        """What an outside system does: releases the cameras through the box."""
        for camera in self.cameras:
            camera.release(exposure_s)
        self.outside.append(Firing(self.world.clock.now(), {camera.name: 0.001 for camera in self.cameras}, 0.5, 0.01))

    def connect(self) -> str:
        self.world.enter(self.name, "connect")
        return "fake trigger"

    def fire(self, exposure_s: float, *, frequency_hz: float | None = None, phase_rad: float | None = None) -> Firing:
        self.world.enter(self.name, "fire", 0.05)
        self.world.fired += 1
        for camera in self.cameras:
            camera.release(exposure_s)
        opening_s = {camera.name: 0.001 * place for place, camera in enumerate(self.cameras, 1)}
        return Firing(self.world.clock.now(), opening_s, phase_rad, 0.01)

    def wait(self, timeout_s: float) -> Firing | None:
        self.world.enter(self.name, "wait", 0.0 if self.outside else timeout_s)
        return self.outside.popleft() if self.outside else None

    def raise_enable(self) -> None:
        self.world.enter(self.name, "raise_enable")
        self.world.heartbeat_at = self.world.clock.monotonic()
        self.world.enabled = True

    def heartbeat(self) -> None:
        self.world.enter(self.name, "heartbeat", 0.0)
        if not self.world.is_enabled():
            raise DeviceRefused("the enable line is down", device=self.name)
        self.world.heartbeat_at = self.world.clock.monotonic()

    def drop_enable(self) -> None:
        self.world.enter(self.name, "drop_enable")
        self.world.enabled = False

    def close(self) -> None:
        self.world.enter(self.name, "close")


@dataclass(slots=True)
class FakeCamera:
    """A body with a card. Its frames are small, and each is unlike any other.

    Attributes
    ----------
    card
        What is on the card: file and content, by handle.
    arriving
        Handle and monotonic time of files that were not yet reported to the host.
    made
        SHA-256 of every frame it ever took.
    late_s
        How much later than usual it has written a file.
    has_date, has_clock
        Whether its files have a date, and whether that is of a clock that runs.
    one_name
        All its files have the same name and, once the one before is deleted, the same handle.
    """

    world: FakeWorld
    name: str
    battery_percent: int | None = 100
    free_bytes: int | None = 8_000_000_000
    card: dict[int, tuple[CardFile, bytes]] = field(default_factory=dict)
    arriving: deque[tuple[int, float]] = field(default_factory=deque)
    made: list[str] = field(default_factory=list)
    exposure_s: float = 1.0
    late_s: float = 0.0
    has_date: bool = True
    has_clock: bool = True
    one_name: bool = False

    def connect(self) -> CameraInfo:
        self.world.enter(self.name, "connect", 0.5)
        return CameraInfo("labdaemon", "fake", self.name)

    def configure(
        self, *, exposure_s: float | None = None, f_number: float | None = None, iso: int | None = None
    ) -> float:
        self.world.enter(self.name, "configure")
        self.exposure_s = exposure_s or self.exposure_s
        return self.exposure_s

    def exposure_steps_s(self) -> tuple[float, ...]:
        self.world.enter(self.name, "exposure_steps_s")
        return (0.5, 1.0, 2.0)

    def status(self) -> CameraStatus:
        self.world.enter(self.name, "status")
        return CameraStatus(self.battery_percent, self.free_bytes)

    def release(self, exposure_s: float) -> None:
        """What the shutter cable does."""
        kind = self.world.enter(self.name, "release", 0.05)
        if kind == "lost_file":
            return
        number = len(self.made) + 1
        opened_s = self.world.clock.monotonic()
        content = (
            f"{self.name} {number} {self.world.frequency_hz} {self.world.amplitude_mm} {self.world.moves()} {opened_s}"
        ).encode()
        self.made.append(hashlib.sha256(content).hexdigest())
        at = EPOCH + timedelta(seconds=opened_s if self.has_clock else 0.0)
        captured_at = at.strftime("%Y%m%dT%H%M%S") if self.has_date else ""
        handle, name = 0x10000 + number, f"DSC_{number:05d}.DNG"
        if self.one_name:
            handle = next(free for free in range(0x10001, 0x20000) if free not in self.card)
            name, content = "DSC_00001.DNG", content.ljust(100)
            self.made[-1] = hashlib.sha256(content).hexdigest()
        self.card[handle] = (CardFile(handle, name, len(content), captured_at), content)
        self.arriving.append((handle, opened_s + exposure_s + 0.5 + self.late_s))

    def wait_file(self, timeout_s: float) -> CardFile | None:
        kind = self.world.enter(self.name, "wait_file")
        if kind == "unexpected_file":
            self.release(0.0)
        now_s = self.world.clock.monotonic()
        if self.arriving and self.arriving[0][1] <= now_s + timeout_s:
            handle, at_s = self.arriving.popleft()
            self.world.spent_s = max(at_s - now_s, 0.01)
            if handle in self.card:
                return self.card[handle][0]
        else:
            self.world.spent_s = max(timeout_s, 0.001)
        return None

    def files(self) -> list[CardFile]:
        self.world.enter(self.name, "files", 0.1)
        now_s = self.world.clock.monotonic()
        unwritten = {handle for handle, at_s in self.arriving if at_s > now_s}
        return [file for handle, (file, _) in self.card.items() if handle not in unwritten]

    def download(self, file: CardFile, to: Path) -> None:
        kind = self.world.enter(self.name, "download", 0.5)
        content = self.card[file.handle][1]
        to.write_bytes(content[: len(content) // 2] if kind == "torn" else content)
        if kind == "torn":
            raise TransportError("the transfer broke", device=self.name)

    def delete(self, file: CardFile) -> None:
        self.world.enter(self.name, "delete")
        self.card.pop(file.handle, None)

    def close(self) -> None:
        self.world.enter(self.name, "close")


@dataclass(slots=True)
class FakeRig:
    """The whole rig: two cameras, shaker, trigger box and a gauge on table and structure."""

    world: FakeWorld
    cameras: list[FakeCamera]
    shaker: FakeShaker
    trigger: FakeTrigger
    gauges: list[FakeGauge]
    rig: Rig


def fake_rig(clock: Clock, *, cameras: tuple[str, ...] = ("left", "right")) -> FakeRig:
    """A rig in memory for a `labdaemon.clock.SimulatedClock`."""
    world = FakeWorld(clock)
    bodies = [FakeCamera(world, name) for name in cameras]
    shaker, trigger = FakeShaker(world), FakeTrigger(world, bodies)
    gauges = [FakeGauge(world, "table", "table"), FakeGauge(world, "response", "response")]

    def line(device: str) -> InlineExecutor:
        return InlineExecutor(device, world.take_spent_s)

    rig = Rig(
        DeviceHandle(shaker, line("shaker")),
        DeviceHandle(trigger, line("trigger")),
        {body.name: DeviceHandle(body, line(body.name)) for body in bodies},
        tuple(DeviceHandle(gauge, line(gauge.name)) for gauge in gauges),
    )
    return FakeRig(world, bodies, shaker, trigger, gauges, rig)
