"""pyserial's handler for ``sim://NAME``: a simulated device of this process's default rig, as a serial port.

pyserial finds this module by its name once its package is listed in `serial.protocol_handler_packages`.
"""

from __future__ import annotations

import threading
import time
from typing import Any
from urllib.parse import urlsplit

from serial import PortNotOpenError, SerialBase, SerialException
from typing_extensions import Buffer

from labdrivers.sim.assembly import default_rig
from labdrivers.sim.wire import WireDevice


class Serial(SerialBase):
    """A port whose other end is a simulated device; reads and writes as a real one does."""

    BAUDRATES = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._arrived = bytearray()
        self._news = threading.Condition()
        self._device: WireDevice | None = None
        self._cut = False
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Attach to the device that the URL names."""
        if self.is_open:
            raise SerialException("Port is already open.")
        name = urlsplit(self.portstr).netloc
        devices = default_rig().wires
        if name not in devices:
            raise SerialException(2, f"there is no simulated device {name!r}; there are {', '.join(sorted(devices))}")
        self._device, self._cut = devices[name], False
        self._arrived.clear()
        self.is_open = True
        self._listener = self._deliver
        self._device.attach(self._listener, self._hung_up)

    def close(self) -> None:
        """Detach."""
        if self.is_open and self._device is not None:
            self.is_open = False
            self._device.detach(self._listener)
            with self._news:
                self._news.notify_all()

    def _deliver(self, data: bytes) -> None:
        with self._news:
            self._arrived += data
            self._news.notify_all()

    def _hung_up(self) -> None:
        with self._news:
            self._cut = True
            self._news.notify_all()

    def _reconfigure_port(self, force_update: bool = False) -> None:
        """Speed and parity mean nothing here."""

    def _update_dtr_state(self) -> None:
        """No such wire."""

    _update_break_state = _update_dtr_state

    def _update_rts_state(self) -> None:
        """The device sees the line."""
        if self._device is not None and self.is_open:
            self._device.set_rts(bool(self.rts))

    @property
    def cts(self) -> bool:
        """An input line that the device drives."""
        return self._device is not None and self._device.cts

    dsr = cts

    @property
    def ri(self) -> bool:
        """No device drives the ring indicator."""
        return False

    cd = ri

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        with self._news:
            return len(self._arrived)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes, waiting no longer than the port's timeout."""
        if not self.is_open:
            raise PortNotOpenError()
        deadline = None if self.timeout is None else time.monotonic() + self.timeout
        with self._news:
            while len(self._arrived) < size and self.is_open:
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    break
                if self._cut and not self._arrived:
                    raise SerialException("device hung up")
                self._news.wait(left)
            taken = bytes(self._arrived[:size])
            del self._arrived[:size]
            return taken

    def write(self, data: Buffer, /) -> int:
        """All bytes, at once."""
        if not self.is_open or self._device is None:
            raise PortNotOpenError()
        if self._cut:
            raise SerialException("device hung up")
        sent = bytes(data)
        self._device.receive(sent)
        return len(sent)

    def flush(self) -> None:
        """Nothing is ever held back."""

    def reset_input_buffer(self) -> None:
        """Forget what came."""
        with self._news:
            self._arrived.clear()

    def reset_output_buffer(self) -> None:
        """Nothing is ever held back."""
