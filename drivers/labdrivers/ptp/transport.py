"""The only place that knows pyusb: containers over a still-image interface's endpoints, with deadlines.

Read sizes are multiples of the packet size and never reach past the current container, so that a header sent apart
from its data, a zero-length packet that comes late and a response glued to its data are all distinguished.
"""

from __future__ import annotations

import errno
import math
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import usb.core
import usb.util

from labdaemon.errors import ProtocolError, TransportError
from labdrivers.ptp.codes import ContainerKind
from labdrivers.ptp.container import HEADER, UNKNOWN_LENGTH, BadContainer, ContainerHeader, read_header

STILL_IMAGE = 6  # USB's class of still-image devices
CANCEL, RESET, STATUS = 0x64, 0x66, 0x67
TO_INTERFACE, FROM_INTERFACE = 0x21, 0xA1
BIGGEST_READ = 1 << 20  # one request of libusb
BIGGEST_CONTAINER = 1 << 30  # no frame is as large: a wrong length must not take the memory
DRAIN_READS = 64  # of what an earlier program left unread
CLOSED_MEANWHILE = (AttributeError, KeyError, TypeError, ValueError)
"""What pyusb lets out when another thread closes the device during a call: its handle is None then, and its lists of
claimed interfaces and endpoints are empty."""


class UsbPipe:
    """A claimed still-image interface.

    Parameters
    ----------
    device
        The camera's name in the rig file, for messages.
    found
        pyusb's device.

    Raises
    ------
    TransportError
        It has no still-image interface, or another program (a desktop's automounter) holds it.
    """

    def __init__(self, device: str, found: Any) -> None:
        self.device = device
        self._usb = found
        interface = still_image_interface(found)
        if interface is None:
            raise TransportError("is no still-image device; set the camera's USB mode to PTP", device=device)
        self._number: int = interface.bInterfaceNumber
        self._is_closed = False
        with self._faults("being claimed"):
            # not every system has such drivers; claiming shows the rest
            with suppress(NotImplementedError, usb.core.USBError):
                if found.is_kernel_driver_active(self._number):
                    found.detach_kernel_driver(self._number)
            usb.util.claim_interface(found, self._number)
        endpoints = list(interface)
        self._out = _endpoint(endpoints, usb.util.ENDPOINT_OUT, usb.util.ENDPOINT_TYPE_BULK)
        self._in = _endpoint(endpoints, usb.util.ENDPOINT_IN, usb.util.ENDPOINT_TYPE_BULK)
        self._interrupt = _endpoint(endpoints, usb.util.ENDPOINT_IN, usb.util.ENDPOINT_TYPE_INTR)
        if self._out is None or self._in is None:
            self.close()
            raise TransportError("has no bulk endpoints; set the camera's USB mode to PTP", device=device)
        self._packet: int = self._in.wMaxPacketSize
        self._left_over = bytearray()

    def close(self) -> None:
        """Release the interface; harmless when the camera is gone. What another thread waits for ends with an error."""
        self._is_closed = True
        self._release()

    def _release(self) -> None:
        with suppress(usb.core.USBError, *CLOSED_MEANWHILE):  # the camera has been unplugged
            usb.util.release_interface(self._usb, self._number)
        with suppress(usb.core.USBError, *CLOSED_MEANWHILE):
            usb.util.dispose_resources(self._usb)

    def _check_open(self) -> None:
        if self._is_closed:
            raise TransportError("connection was closed by another call; connect again", device=self.device)

    def send(self, container: bytes, timeout_s: float) -> None:
        """Write one container, ended by a zero-length packet where its size is a multiple of the packet's."""
        with self._faults("receiving"):
            for last in (False, True):
                try:
                    self._out.write(container, _ms(timeout_s))
                    break
                except usb.core.USBError as exc:
                    if exc.errno != errno.EPIPE or last:
                        raise
                    self._out.clear_halt()
            if len(container) % self._out.wMaxPacketSize == 0:
                self._out.write(b"", _ms(timeout_s))

    def receive(self, deadline: float, *, first: bool = True) -> tuple[ContainerHeader, bytes]:
        """Read one container.

        Parameters
        ----------
        deadline
            `time.monotonic` seconds.
        first
            Nothing of this transaction was read yet: a stall is cleared and read over once. Later it is a fault.

        Raises
        ------
        TransportError
            It is not complete by then, or the pipe broke.
        ProtocolError
            What came is none.
        """
        data, self._left_over = self._left_over, bytearray()
        data += self._read(self._packet, deadline, first=first) if len(data) < HEADER.size else b""
        if len(data) < HEADER.size:
            data += self._read(self._packet, deadline)
        try:
            header = read_header(data)
        except BadContainer as exc:
            raise ProtocolError(f"sent no container: {exc}; reset the camera", device=self.device) from None
        if header.length == UNKNOWN_LENGTH and header.kind == ContainerKind.DATA:
            self._read_to_short(data, deadline)
        elif header.length > BIGGEST_CONTAINER:
            raise ProtocolError(f"announces a container of {header.length} bytes; reset the camera", device=self.device)
        else:
            while len(data) < header.length:
                missing = math.ceil((header.length - len(data)) / self._packet) * self._packet
                data += self._read(min(missing, BIGGEST_READ), deadline)
            self._left_over = data[header.length :]
            del data[header.length :]
        return header, bytes(data[HEADER.size :])

    def _read_to_short(self, data: bytearray, deadline: float) -> None:
        """Go on until a transfer brings less than was asked for: a short packet, or an empty one, ended it."""
        ended = len(data) % self._packet != 0
        while not ended:
            self._check_open()
            chunk = self._in_read(BIGGEST_READ, deadline)
            data += chunk
            ended = len(chunk) < BIGGEST_READ

    def _read(self, size: int, deadline: float, *, first: bool = False) -> bytes:
        """One transfer; an empty one is a late zero-length packet and is read over once."""
        chunk = self._in_read(size, deadline, stall_ok=first)
        if not chunk:
            chunk = self._in_read(size, deadline)
        if not chunk:
            raise ProtocolError("sends empty packets where data belongs; reset the camera", device=self.device)
        return chunk

    def _in_read(self, size: int, deadline: float, *, stall_ok: bool = False) -> bytes:
        with self._faults("answering"):
            try:
                return bytes(self._in.read(size, _ms(deadline - time.monotonic())))
            except usb.core.USBError as exc:
                if exc.errno != errno.EPIPE:
                    raise
                self._in.clear_halt()
                if not stall_ok:
                    raise
            return bytes(self._in.read(size, _ms(deadline - time.monotonic())))

    def read_interrupt(self, timeout_s: float) -> bytes | None:
        """One packet of the interrupt endpoint; None when none came, empty endpoint included."""
        if self._interrupt is None:
            self._check_open()
            time.sleep(timeout_s)
            return None
        with self._faults("signalling"):
            try:
                return bytes(self._interrupt.read(self._interrupt.wMaxPacketSize, _ms(timeout_s)))
            except usb.core.USBTimeoutError:  # no event within the time: the ordinary case
                return None
            except usb.core.USBError as exc:
                if exc.errno == errno.EPIPE:
                    self._interrupt.clear_halt()
                    return None
                raise

    def cancel(self, transaction: int, timeout_s: float) -> None:
        """Give up a transaction by the class request, wait until the device agrees, throw its leftovers away."""
        with self._faults("cancelling"):
            request = struct.pack("<HI", 0x4001, transaction)
            self._usb.ctrl_transfer(TO_INTERFACE, CANCEL, 0, self._number, request, _ms(timeout_s))
            self._drain()
            deadline = time.monotonic() + timeout_s
            while time.monotonic() < deadline and self._status() == 0x2019:
                self._check_open()
                time.sleep(0.05)

    def reset(self, timeout_s: float) -> None:
        """Class request RESET: the device forgets its session."""
        with self._faults("resetting"):
            self._usb.ctrl_transfer(TO_INTERFACE, RESET, 0, self._number, None, _ms(timeout_s))
            for endpoint in (self._in, self._out):
                with suppress(usb.core.USBError):
                    endpoint.clear_halt()
            self._drain()

    def _status(self) -> int:
        answer = bytes(self._usb.ctrl_transfer(FROM_INTERFACE, STATUS, 0, self._number, 32, 1000))
        return int(struct.unpack_from("<H", answer, 2)[0]) if len(answer) >= 4 else 0

    def _drain(self) -> None:
        self._left_over.clear()
        for _ in range(DRAIN_READS):
            self._check_open()
            try:
                self._in.read(BIGGEST_READ, 50)
            except usb.core.USBTimeoutError:  # nothing is left to read
                return
            except usb.core.USBError as exc:
                if exc.errno != errno.EPIPE:
                    raise
                self._in.clear_halt()

    @contextmanager
    def _faults(self, doing: str) -> Iterator[None]:
        self._check_open()
        try:
            yield
        except usb.core.USBTimeoutError as exc:
            raise TransportError(
                f"no answer while {doing}; check its battery, or switch it off and on", device=self.device
            ) from exc
        except usb.core.USBError as exc:
            raise TransportError(f"{_reason(exc)} while {doing}", device=self.device) from exc
        except CLOSED_MEANWHILE as exc:
            raise TransportError(
                f"connection lost while {doing} ({type(exc).__name__}: {exc}); connect again", device=self.device
            ) from exc
        finally:
            if self._is_closed:  # pyusb claims an interface anew for each transfer: it would keep the next pipe out
                self._release()


def still_image_interface(found: Any) -> Any | None:
    """The PTP interface of a USB device, None if it has none."""
    try:
        for configuration in found:
            for interface in configuration:
                if interface.bInterfaceClass == STILL_IMAGE:
                    return interface
    except (usb.core.USBError, *CLOSED_MEANWHILE):
        return None
    return None


def _endpoint(endpoints: list[Any], direction: int, kind: int) -> Any:
    matches: Callable[[Any], bool] = lambda e: (  # noqa: E731
        usb.util.endpoint_direction(e.bEndpointAddress) == direction and usb.util.endpoint_type(e.bmAttributes) == kind
    )
    return next(filter(matches, endpoints), None)


def _ms(seconds: float) -> int:
    return max(1, math.ceil(seconds * 1000))  # 0 would wait for ever


def _reason(exc: usb.core.USBError) -> str:
    match exc.errno:
        case errno.ENODEV | errno.ENOENT | errno.ESHUTDOWN:
            return "camera gone from the bus; check cable and power"
        case errno.EBUSY:
            return "held by another program (close the desktop's photo importer)"
        case errno.EACCES | errno.EPERM:
            return (
                "no permission for the USB device; install systemd/60-labdaemon-cameras.rules, join plugdev, replug it"
            )
        case errno.EPIPE:
            return "pipe error"
    return f"USB error ({exc.strerror or exc})"
