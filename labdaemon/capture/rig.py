"""The physical set-up as the daemon holds it: each driver with its executor, and the deadlines of its calls."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from labdaemon.capture.device_executor import DeviceExecutor
from labdaemon.capture.devices import Camera, Gauge, Shaker, Trigger
from labdaemon.errors import DeviceError, DriverFault, LabdaemonError

log: logging.Logger = logging.getLogger(__name__)

D = TypeVar("D")
T = TypeVar("T")

CALL_S = 10.0
"""Deadline of an ordinary call; drivers' own are shorter."""

SOFT_STOP_S = 8.0
"""A ramp from full stroke to rest takes this long at most; drivers notice a silent wire long before."""

HARD_STOP_S = 4.0
"""A hard stop may open the wire anew once, and identify the device again."""

OBSERVE_S = 1.0
"""A question that only watches, on a wire that is slow but lives."""


@dataclass(frozen=True, slots=True)
class DeviceHandle(Generic[D]):
    """A driver, and the executor that calls it."""

    driver: D
    executor: DeviceExecutor

    async def call(self, function: Callable[[D], T], timeout_s: float = CALL_S) -> T:
        """Call it in turn; `TransportError` past the deadline, `DriverFault` for an error that is none of ours."""
        with self._as_device_error():
            return await self.executor.call(lambda: function(self.driver), timeout_s)

    async def urgent(self, function: Callable[[D], T], timeout_s: float = HARD_STOP_S) -> T:
        """Call it at once, whatever it is busy with."""
        with self._as_device_error():
            return await self.executor.urgent(lambda: function(self.driver), timeout_s)

    async def observe(self, function: Callable[[D], T], timeout_s: float = OBSERVE_S) -> T:
        """Ask it meanwhile, behind other such questions only; see `DeviceExecutor.observe`."""
        with self._as_device_error():
            return await self.executor.observe(lambda: function(self.driver), timeout_s)

    @contextmanager
    def _as_device_error(self) -> Iterator[None]:
        """An error in a driver counts as a fault of its device, and must not end what stops the table."""
        try:
            yield
        except LabdaemonError:
            raise
        except Exception as exc:
            name = str(getattr(self.driver, "name", type(self.driver).__name__))
            log.exception("the driver of %s failed", name)
            raise DriverFault(f"its driver failed ({type(exc).__name__}: {exc}); report this", device=name) from exc


@dataclass(frozen=True, slots=True)
class Rig:
    """All devices by what they are; `shaker` and `trigger` are None where others hold them."""

    shaker: DeviceHandle[Shaker] | None
    trigger: DeviceHandle[Trigger] | None
    cameras: Mapping[str, DeviceHandle[Camera]]
    gauges: tuple[DeviceHandle[Gauge], ...] = field(default=())

    def gauge(self, role: Literal["table", "response"]) -> DeviceHandle[Gauge] | None:
        """The first gauge mounted there, if any."""
        return next((gauge for gauge in self.gauges if gauge.driver.role == role), None)

    async def close(self) -> None:
        """Give every wire back. The table must be at rest."""
        devices: list[DeviceHandle[Any]] = [*self.gauges, *self.cameras.values()]
        devices += [device for device in (self.trigger, self.shaker) if device is not None]
        for device in devices:
            try:
                await device.call(lambda driver: driver.close(), HARD_STOP_S)
            except DeviceError:
                pass  # it is gone already; nothing else hangs on it
            finally:
                device.executor.close()
