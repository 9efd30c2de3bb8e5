"""A simulated USB bus: cameras are plugged in and out, get a new address each time, and are claimed by one host.

`UsbBus` is what a pyusb backend needs of it, here directly, elsewhere through a connection (`usb_remote`).
"""

from __future__ import annotations

import errno
import struct
import threading
from dataclasses import asdict, dataclass
from typing import Any, Protocol

from labdrivers.sim.ptp_device import MAKER, MODEL
from labdrivers.sim.usb_device import EP_IN, EP_INTERRUPT, EP_OUT, PRODUCT, VENDOR, UsbCamera, UsbFault

LANGUAGE = 0x0409


@dataclass(frozen=True, slots=True)
class UsbDeviceInfo:
    """What enumeration reports of a device."""

    address: int
    vendor: int
    product: int

    def as_dict(self) -> dict[str, Any]:
        """For messages."""
        return asdict(self)


class UsbBus(Protocol):
    """What a backend may ask; every method may raise `UsbFault`."""

    def devices(self) -> list[UsbDeviceInfo]:
        """Everything plugged in."""
        ...

    def open(self, address: int) -> int:
        """A handle for a device."""
        ...

    def close(self, handle: int) -> None:
        """Give a handle, and what it claimed, back."""
        ...

    def claim(self, handle: int) -> None:
        """Claim the device's interface for this handle."""
        ...

    def release(self, handle: int) -> None:
        """Give the interface back."""
        ...

    def write(self, handle: int, endpoint: int, data: bytes) -> int:
        """OUT transfer."""
        ...

    def read(self, handle: int, endpoint: int, size: int, timeout_ms: int) -> bytes:
        """IN transfer."""
        ...

    def control(self, handle: int, request_type: int, request: int, value: int, data: bytes, length: int) -> bytes:
        """Control transfer, either direction."""
        ...

    def clear_halt(self, handle: int, endpoint: int) -> None:
        """Clear a stall."""
        ...


class SimulatedBus:
    """The bus of one rig, cameras by name."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._next_address, self._next_handle = 4, 1
        self._plugged: dict[int, UsbCamera] = {}
        self._handles: dict[int, int] = {}
        self._claims: dict[int, int] = {}
        self.cameras: dict[str, UsbCamera] = {}

    def add(self, name: str, camera: UsbCamera) -> None:
        """A new camera, plugged in at once."""
        self.cameras[name] = camera
        self.plug(name)

    def plug(self, name: str) -> int:
        """Plug a camera in; return its address, never the same twice."""
        with self._lock:
            address = self._next_address
            self._next_address += 1
            self._plugged[address] = self.cameras[name]
            return address

    def unplug(self, name: str) -> None:
        """Pull a camera's cable."""
        camera = self.cameras[name]
        with self._lock:
            gone = [address for address, device in self._plugged.items() if device is camera]
            for address in gone:
                del self._plugged[address]
                self._claims.pop(address, None)
        camera.unplugged()

    def devices(self) -> list[UsbDeviceInfo]:
        """Everything plugged in."""
        with self._lock:
            return [UsbDeviceInfo(address, VENDOR, PRODUCT) for address in self._plugged]

    def open(self, address: int) -> int:
        """A handle for a device."""
        with self._lock:
            if address not in self._plugged:
                raise UsbFault(errno.ENODEV, "No such device (it may have been disconnected)")
            handle = self._next_handle
            self._next_handle += 1
            self._handles[handle] = address
            return handle

    def close(self, handle: int) -> None:
        """Give a handle, and what it claimed, back."""
        with self._lock:
            address = self._handles.pop(handle, None)
            if address is not None and self._claims.get(address) == handle:
                del self._claims[address]

    def claim(self, handle: int) -> None:
        """Claim the device's interface for this handle."""
        self._camera(handle, claimed=False)
        with self._lock:
            owner = self._claims.setdefault(self._handles[handle], handle)
        if owner != handle:
            raise UsbFault(errno.EBUSY, "Resource busy")

    def release(self, handle: int) -> None:
        """Give the interface back."""
        with self._lock:
            address = self._handles.get(handle)
            if address is not None and self._claims.get(address) == handle:
                del self._claims[address]

    def write(self, handle: int, endpoint: int, data: bytes) -> int:
        """OUT transfer."""
        return self._camera(handle).write(endpoint, data)

    def read(self, handle: int, endpoint: int, size: int, timeout_ms: int) -> bytes:
        """IN transfer; a device unplugged meanwhile ends it."""
        camera = self._camera(handle)
        try:
            return camera.read(endpoint, size, timeout_ms)
        except UsbFault:
            self._camera(handle)  # gone is gone, whatever the endpoint said last
            raise

    def control(self, handle: int, request_type: int, request: int, value: int, data: bytes, length: int) -> bytes:
        """Control transfer: string descriptors here, class requests at the device."""
        camera = self._camera(handle, claimed=False)
        if request_type == 0x80 and request == 6 and value >> 8 == 3:
            return _string_descriptor(camera, value & 0xFF)[:length]
        if request_type == 0x02 and request == 1:
            camera.clear_halt(value)
            return b""
        return camera.control(request_type, request, data, length)

    def clear_halt(self, handle: int, endpoint: int) -> None:
        """Clear a stall."""
        self._camera(handle).clear_halt(endpoint)

    def _camera(self, handle: int, *, claimed: bool = True) -> UsbCamera:
        with self._lock:
            address = self._handles.get(handle)
            camera = self._plugged.get(address) if address is not None else None
            if address is None or camera is None:
                raise UsbFault(errno.ENODEV, "No such device (it may have been disconnected)")
            if claimed and self._claims.get(address) != handle:
                raise UsbFault(errno.EBUSY, "Resource busy")
            return camera


def _string_descriptor(camera: UsbCamera, index: int) -> bytes:
    if index == 0:
        return struct.pack("<BBH", 4, 3, LANGUAGE)
    texts = {1: MAKER, 2: MODEL, 3: camera.body.serial}
    if index not in texts:
        raise UsbFault(errno.EPIPE, "no such string")
    encoded = texts[index].encode("utf-16-le")
    return bytes([2 + len(encoded), 3]) + encoded


ENDPOINTS = ((EP_IN, 2, 512), (EP_OUT, 2, 512), (EP_INTERRUPT, 3, 24))
"""Address, transfer type and packet size, in the interface's order."""
