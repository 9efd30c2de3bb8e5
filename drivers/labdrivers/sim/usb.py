"""A pyusb backend in pure Python, over the simulated bus of this process or of the simulator's own process.

pyusb's calls end here instead of in libusb; what they see are descriptors, endpoints, packets and errno values.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from types import SimpleNamespace
from typing import Any, TypeVar

import usb.backend
from usb.core import USBError, USBTimeoutError

from labdrivers.sim.usb_bus import ENDPOINTS, UsbBus, UsbDeviceInfo
from labdrivers.sim.usb_device import UsbFault

T = TypeVar("T")


class SimulatedBackend(usb.backend.IBackend):  # type: ignore[misc]
    """What pyusb needs, over a `UsbBus`.

    Parameters
    ----------
    bus
        The cameras.
    """

    def __init__(self, bus: UsbBus) -> None:
        self._bus = bus

    def enumerate_devices(self) -> Iterator[UsbDeviceInfo]:
        """Everything on the bus."""
        return iter(_translate(self._bus.devices))

    def get_parent(self, dev: UsbDeviceInfo) -> None:
        """No hubs."""

    def get_device_descriptor(self, dev: UsbDeviceInfo) -> SimpleNamespace:
        """As a high-speed device."""
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=dev.vendor, idProduct=dev.product, bcdDevice=0x0100, iManufacturer=1,
            iProduct=2, iSerialNumber=3, bNumConfigurations=1, address=dev.address, bus=1, port_number=dev.address,
            port_numbers=(dev.address,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: UsbDeviceInfo, config: int) -> SimpleNamespace:
        """The only one."""
        if config != 0:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=39, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0xC0, bMaxPower=1, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: UsbDeviceInfo, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Still image, PIMA 15740."""
        if intf != 0 or alt != 0:
            raise IndexError(intf)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=len(ENDPOINTS),
            bInterfaceClass=6, bInterfaceSubClass=1, bInterfaceProtocol=1, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: UsbDeviceInfo, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Bulk in, bulk out, interrupt."""
        address, attributes, packet = ENDPOINTS[ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=attributes, wMaxPacketSize=packet,
            bInterval=4, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: UsbDeviceInfo) -> int:
        """A handle."""
        return _translate(lambda: self._bus.open(dev.address))

    def close_device(self, dev_handle: int) -> None:
        """Give it back; like libusb's, this cannot fail."""
        with suppress(UsbFault):
            self._bus.close(dev_handle)

    def set_configuration(self, dev_handle: int, config_value: int) -> None:
        """There is one, and it is set."""

    def get_configuration(self, dev_handle: int) -> int:
        """The only one."""
        return 1

    def claim_interface(self, dev_handle: int, intf: int) -> None:
        """For this handle alone."""
        _translate(lambda: self._bus.claim(dev_handle))

    def release_interface(self, dev_handle: int, intf: int) -> None:
        """Back again."""
        _translate(lambda: self._bus.release(dev_handle))

    def bulk_write(self, dev_handle: int, ep: int, intf: int, data: Any, timeout: int) -> int:
        """OUT."""
        return _translate(lambda: self._bus.write(dev_handle, ep, bytes(data)))

    def bulk_read(self, dev_handle: int, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """IN, into pyusb's buffer."""
        got = _translate(lambda: self._bus.read(dev_handle, ep, len(buff) * buff.itemsize, timeout))
        memoryview(buff).cast("B")[: len(got)] = got
        return len(got)

    intr_read = bulk_read

    def ctrl_transfer(
        self,
        dev_handle: int,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,
    ) -> int:
        """Either direction; IN fills pyusb's buffer."""
        inward = bool(bmRequestType & 0x80)
        sent = b"" if inward else bytes(data)
        room = len(data) * data.itemsize if inward else 0
        got = _translate(lambda: self._bus.control(dev_handle, bmRequestType, bRequest, wValue, sent, room))
        if inward:
            memoryview(data).cast("B")[: len(got)] = got
            return len(got)
        return len(sent)

    def clear_halt(self, dev_handle: int, ep: int) -> None:
        """Clear a stall."""
        _translate(lambda: self._bus.clear_halt(dev_handle, ep))

    def is_kernel_driver_active(self, dev_handle: int, intf: int) -> bool:
        """Never: no kernel here."""
        return False


def _translate(call: Callable[[], T]) -> T:
    try:
        return call()
    except UsbFault as exc:
        kind = USBTimeoutError if exc.number == errno.ETIMEDOUT else USBError
        raise kind(str(exc), None, exc.number) from None


def get_backend() -> SimulatedBackend:
    """The bus of this process's default rig: entry point ``sim``."""
    from labdrivers.sim.assembly import default_rig

    return SimulatedBackend(default_rig().bus)


@lru_cache
def get_remote_backend(url: str) -> SimulatedBackend:
    """The bus of a rig in a process of its own, ``tcp://host:port``: entry point ``sim-remote``."""
    from labdrivers.sim.usb_remote import RemoteBus

    return SimulatedBackend(RemoteBus(url))
