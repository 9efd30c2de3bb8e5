"""The simulated laboratory put together: one rig, and on its wires a generator, a trigger box, gauges and cameras.

The shaker's generator moves the rig; the trigger box releases the cameras by cable; what they saw lands on
their cards. `default_rig` is the one that ``sim://`` ports and the ``sim`` USB backend of a process share.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path

from labdrivers.sim.faults import Faults
from labdrivers.sim.gauge_device import GaugeDevice
from labdrivers.sim.lamp_output import LampOutput
from labdrivers.sim.ptp_card import MemoryCard
from labdrivers.sim.ptp_device import PtpBody
from labdrivers.sim.render_pool import RenderPool
from labdrivers.sim.rig import RigModel
from labdrivers.sim.scpi_device import ScpiDevice
from labdrivers.sim.shutter_cable import ShutterCable
from labdrivers.sim.spec import RigSpec
from labdrivers.sim.trigger_device import TriggerDevice
from labdrivers.sim.usb_bus import SimulatedBus
from labdrivers.sim.usb_device import UsbCamera
from labdrivers.sim.wire import WireDevice


class TableWires:
    """The rig's table as its generator and the trigger box are wired to it.

    Parameters
    ----------
    enable_wired
        Whether the box's enable line goes to the amplifier; if not, the amplifier is always enabled.
    """

    def __init__(self, rig: RigModel, clock: Callable[[], float], *, enable_wired: bool) -> None:
        self._rig, self._clock, self._wired = rig, clock, enable_wired
        self._offset_rad = 0.0

    def drive(self, *, frequency_hz: float, level_v: float, running: bool, phase_rad: float) -> None:
        """The generator's output; its phase offset is between sync and sine."""
        self._offset_rad = phase_rad
        self._rig.drive(self._clock(), frequency_hz=frequency_hz, level_v=level_v, running=running)

    def amplifier_on(self) -> bool:
        """Whether the amplifier is enabled, for a controller that reports it."""
        return self._rig.enabled or not self._wired

    def enable(self, up: bool) -> None:
        """The box's enable line."""
        if self._wired:
            self._rig.enable(self._clock(), up)

    def sync(self, t: float) -> tuple[float, float] | None:
        """Last edge of the generator's sync output and its period."""
        frequency_hz, phase_rad = self._rig.frequency_hz(t), self._rig.excitation_phase(t)
        if frequency_hz is None or phase_rad is None:
            return None
        since = (phase_rad - self._offset_rad) % (2 * math.pi) / (2 * math.pi * frequency_hz)
        return t - since, 1 / frequency_hz


class RigCamera:
    """What one camera of the rig has before its lens.

    Parameters
    ----------
    light_until_now
        Brings the lamp's history up to the present: on a busy computer the thread of the box that switches the lamp may
        come after the one of the shutter that has closed.
    """

    def __init__(self, rig: RigModel, name: str, pool: RenderPool, light_until_now: Callable[[], None]) -> None:
        self._rig, self._name, self._pool, self._light_until_now = rig, name, pool, light_until_now
        self.lag_s = rig.spec.cameras[name].opening_lag_s

    def expose(self, opened_s: float, exposure_s: float, *, iso: int, f_number: float) -> bytes:
        """Render the exposure that has just ended."""
        self._light_until_now()
        stamp = time.strftime("%Y:%m:%d %H:%M:%S")
        job = self._rig.exposure_job(self._name, opened_s, exposure_s, iso=iso, f_number=f_number, captured_at=stamp)
        return self._pool.render(job)


class SimulatedRig:
    """Everything, ready to be talked to.

    Parameters
    ----------
    spec
        The laboratory in numbers.
    cards
        Directory for the cameras' cards; temporary ones if None.
    enable_wired
        Whether the amplifier needs the trigger box's enable line.

    Attributes
    ----------
    wires
        Serial devices by name: ``shaker``, ``trigger``, ``gauge-table``, ``gauge-response``, and ``shutter``, the
        cable for a trigger without box.
    bus
        The USB bus with the cameras, by the rig's names.
    """

    def __init__(self, spec: RigSpec | None = None, *, cards: Path | None = None, enable_wired: bool = True) -> None:
        self.clock = time.monotonic
        self.rig = RigModel(spec)
        self._pool = RenderPool()
        table = TableWires(self.rig, self.clock, enable_wired=enable_wired)
        self.bus = SimulatedBus()
        bodies = []
        for name, camera in self.rig.spec.cameras.items():
            card = MemoryCard(None if cards is None else cards / name)
            exposer = RigCamera(self.rig, name, self._pool, self._light_until_now)
            body = PtpBody(camera.serial, exposer, card=card, clock=self.clock)
            bodies.append(body)
            self.bus.add(name, UsbCamera(body))
        self.shaker = ScpiDevice(table)
        self.lamp = LampOutput(self.rig.set_lamp, self.rig.spec.lamp.levels)
        self.trigger = TriggerDevice(
            bodies, table, clock=self.clock, lamp=self.lamp, tick_error=self.rig.spec.box_tick_error
        )
        self.wires: dict[str, WireDevice] = {
            "shaker": self.shaker,
            "trigger": self.trigger,
            "gauge-table": GaugeDevice(self.rig.table_mm, clock=self.clock, seed=1),
            "gauge-response": GaugeDevice(self.rig.response_mm, clock=self.clock, seed=2),
            "shutter": ShutterCable(bodies, clock=self.clock),
        }

    def _light_until_now(self) -> None:
        """The trigger box is made after the cameras that it releases."""
        self.trigger.catch_up()

    def moving(self) -> bool:
        """Whether the table is moving now."""
        return self.rig.moving(self.clock())

    def faults(self) -> dict[str, list[Faults]]:
        """The fault switches of every device by name; a camera has those of its body and those of its USB
        side, the trigger box those of its lamp output, too.
        """
        switches = {name: [wire.faults] for name, wire in self.wires.items()}
        switches["trigger"].append(self.lamp.faults)
        for name, camera in self.bus.cameras.items():
            switches[name] = [camera.body.faults, camera.faults]
        return switches

    def shut_down(self) -> None:
        """Power everything off."""
        for wire in self.wires.values():
            wire.hang_up()
            wire.shut_down()
        self._pool.close()


_DEFAULT_LOCK = threading.Lock()
_DEFAULT: list[SimulatedRig] = []


def default_rig() -> SimulatedRig:
    """The rig of this process, made when first asked for."""
    with _DEFAULT_LOCK:
        if not _DEFAULT:
            _DEFAULT.append(SimulatedRig())
        return _DEFAULT[0]


def set_default_rig(rig: SimulatedRig | None) -> None:
    """Make another rig the one of this process; None forgets it, so that the next use makes a new one."""
    with _DEFAULT_LOCK:
        _DEFAULT[:] = [] if rig is None else [rig]
