"""Finding a camera on the bus by its serial number: its address changes with every replug."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import entry_points
from typing import Any

import usb.core

from labdaemon.errors import ConfigError, DeviceError, TransportError
from labdrivers.ptp.session import PtpSession
from labdrivers.ptp.transport import UsbPipe, still_image_interface

BACKEND_GROUP = "labdaemon.usb_backends"
_PROBING = threading.Lock()
"""Only one camera's driver looks around at a time: probing claims devices for a moment."""


def load_backend(name: str, url: str | None, *, key: str) -> Any:
    """Pyusb's backend of this name: ``libusb``, or one that another package offers.

    Raises
    ------
    ConfigError
        There is none of this name, or libusb does not load.
    """
    if name == "libusb":
        import libusb_package

        backend = libusb_package.get_libusb1_backend()
        if backend is None:
            raise ConfigError("libusb does not load; reinstall libusb-package", key=key)
        return backend
    found = list(entry_points(group=BACKEND_GROUP, name=name))
    if not found:
        known = sorted({"libusb", *(entry.name for entry in entry_points(group=BACKEND_GROUP))})
        raise ConfigError(f"unknown USB backend {name!r}; there are {', '.join(known)}", key=key)
    factory = found[0].load()
    return factory(url) if url else factory()


def open_camera(name: str, serial: str, backend: Any, *, timeout_s: float) -> tuple[UsbPipe, PtpSession]:
    """Claim the camera with this serial number and open a session on it.

    Raises
    ------
    TransportError
        It is not on the bus (the message lists which are), or is held by another program.
    """
    seen: list[str] = []
    held: DeviceError | None = None
    with _PROBING:
        for device in _likely_first(_cameras(name, backend), serial):
            descriptor = _descriptor_serial(device)
            try:
                pipe = UsbPipe(name, device)
            except TransportError as exc:
                if descriptor is not None and _same(descriptor, serial):
                    raise
                held = exc
                continue
            try:
                session = PtpSession(pipe, timeout_s=timeout_s)
                session.open()
                if _same(session.info.serial, serial):
                    return pipe, session
                seen.append(f"{session.info.model} {session.info.serial}")
                session.close()
            except DeviceError as exc:
                if descriptor is not None and _same(descriptor, serial):
                    pipe.close()
                    raise
                held = exc
            pipe.close()
    found = f"found {'; '.join(seen)}" if seen else "found no camera"
    trouble = f", and one that cannot be asked ({held})" if held is not None else ""
    raise TransportError(
        f"no camera with serial number {serial} on USB ({found}{trouble}); switch it on and check its cable",
        device=name,
    )


def _cameras(name: str, backend: Any) -> list[Any]:
    try:
        found = usb.core.find(find_all=True, backend=backend)
        return [device for device in found if still_image_interface(device) is not None]
    except (usb.core.USBError, usb.core.NoBackendError) as exc:
        raise TransportError(f"USB cannot be searched ({exc})", device=name) from exc


def _likely_first(devices: list[Any], serial: str) -> Iterator[Any]:
    """Cameras whose USB descriptor has the serial number; others only if they do not tell it there."""
    told = [(device, _descriptor_serial(device)) for device in devices]
    exact = [device for device, own in told if own is not None and _same(own, serial)]
    yield from exact
    yield from (device for device, own in told if not exact or own is None if device not in exact)


def _descriptor_serial(device: Any) -> str | None:
    with suppress(usb.core.USBError, ValueError, NotImplementedError):
        text = device.serial_number
        return str(text) if text else None
    return None


def _same(a: str, b: str) -> bool:
    """Bodies pad their number with zeros on one side or the other."""
    return a.strip().lstrip("0") == b.strip().lstrip("0")
