"""Finding a camera on the bus by its serial number: its address changes with every replug."""

from __future__ import annotations

import threading
from contextlib import suppress
from importlib.metadata import entry_points
from typing import Any

import usb.core

from labdaemon.errors import ConfigError, DeviceError, TransportError
from labdrivers.ptp.session import PtpSession
from labdrivers.ptp.transport import UsbPipe, still_image_interface

BACKEND_GROUP = "labdaemon.usb_backends"
_PROBING = threading.Lock()
"""Only one camera's driver asks around at a time: it claims, for a moment, bodies that may be another's."""


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
    cameras = [(device, _descriptor_serial(device)) for device in _cameras(name, backend)]
    for device, own in cameras:
        if own is not None and _same(own, serial):
            return _open(name, device, timeout_s)
    seen = [f"one with serial number {own}" for _, own in cameras if own is not None]
    held: DeviceError | None = None
    with _PROBING:
        for device in (device for device, own in cameras if own is None):
            try:
                pipe, session = _open(name, device, timeout_s)
            except DeviceError as exc:
                held = exc
                continue
            if _same(session.info.serial, serial):
                return pipe, session
            seen.append(f"{session.info.model} with serial number {session.info.serial}")
            session.close()
            pipe.close()
    found = f"found {', '.join(seen)}" if seen else "found no camera"
    trouble = f", and one that cannot be asked ({held})" if held is not None else ""
    raise TransportError(
        f"no camera with serial number {serial} on USB ({found}{trouble}); switch it on and check its cable"
        + (", or correct `serial` in the rig file" if seen else ""),
        device=name,
    )


def _open(name: str, device: Any, timeout_s: float) -> tuple[UsbPipe, PtpSession]:
    """Claim a device, open a session and ask who it is; nothing stays claimed when that fails."""
    pipe = UsbPipe(name, device)
    try:
        session = PtpSession(pipe, timeout_s=timeout_s)
        session.open()
        session.info  # noqa: B018 - asked here, so that a body that cannot tell is let go
    except DeviceError:
        pipe.close()
        raise
    return pipe, session


def _cameras(name: str, backend: Any) -> list[Any]:
    try:
        found = usb.core.find(find_all=True, backend=backend)
        return [device for device in found if still_image_interface(device) is not None]
    except (usb.core.USBError, usb.core.NoBackendError) as exc:
        raise TransportError(f"USB cannot be searched ({exc})", device=name) from exc


def _descriptor_serial(device: Any) -> str | None:
    # no permission or no string: another way is tried
    with suppress(usb.core.USBError, ValueError, NotImplementedError):
        text = device.serial_number
        return str(text) if text else None
    return None


def _same(a: str, b: str) -> bool:
    """Bodies pad their number with zeros on one side or the other."""
    return a.strip().lstrip("0") == b.strip().lstrip("0")
