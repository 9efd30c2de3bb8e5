"""The only place that knows pyserial: lines and bytes over a serial port, a socket or a simulator, with deadlines.

A port is named by what `serial.serial_for_url` takes: ``/dev/ttyUSB0``, ``socket://host:port``,
``rfc2217://host:port``. Further schemes come from packages named by entry points in the group
``labdaemon.serial_urls`` (entry point's name: the scheme; value: a package with a module ``protocol_<scheme>``), which
is how a simulated device gets a URL without any driver knowing it.

pyserial's habits that are taken care of here: opening flushes input, so there is no banner to wait for; a
closed peer, a pulled adapter and an ioctl that a pty lacks come as `SerialException`, `OSError` or `termios.error`;
Linux raises DTR and RTS on opening unless both are set beforehand; changing a port's timeout reconfigures it (over
the network with RFC 2217), so one short timeout is set at the start and deadlines are kept here.
"""

from __future__ import annotations

import errno
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from typing import Literal

import serial
from pydantic import Field

from labdaemon.errors import ConfigError, ProtocolError, TransportError
from labdrivers.settings import DriverSettings

URL_GROUP = "labdaemon.serial_urls"
TICK_S = 0.02
"""How long one read waits inside pyserial: deadlines are kept to this."""
OPEN_FAULTS = (serial.SerialException, OSError, termios.error)
CLOSED_MEANWHILE = (TypeError, AttributeError, ValueError)
"""What pyserial lets out when another thread closes the port during a call: its descriptor or socket is None then, or
closed (`select` refuses descriptor -1 with a ValueError)."""


class PortSettings(DriverSettings):
    """Keys that every driver on a serial line shares."""

    port: str = Field(min_length=1)
    baudrate: int = Field(default=115200, gt=0)
    bytesize: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stopbits: Literal[1, 2] = 1
    handshake: Literal["none", "rtscts", "dsrdtr", "xonxoff"] = "none"
    timeout_s: float = Field(default=2.0, gt=0, le=60)
    exclusive: bool = True
    """Lock the device file, which is advisory: it keeps a second daemon off, not every program. What must stop a table
    whose daemon hangs opens the port without."""


class SerialLine:
    """A port with deadlines; every failure is a `TransportError` that names the device and what to do.

    Parameters
    ----------
    device
        The device's name in the rig file.
    settings
        Port, speed and deadlines.
    raise_lines
        Whether to raise DTR and RTS on opening. False for boxes that reset or fire on them.
    longest_line
        More bytes than this without an end of line are rubbish.
    """

    def __init__(
        self, device: str, settings: PortSettings, *, raise_lines: bool = True, longest_line: int = 4096
    ) -> None:
        self.device, self.settings = device, settings
        self._raise_lines, self._longest_line = raise_lines, longest_line
        self._port: serial.Serial | None = None
        self._buffer = bytearray()
        self._write_lock = threading.Lock()
        self._open_lock = threading.Lock()

    @property
    def is_open(self) -> bool:
        """Whether the port was opened and not closed since."""
        return self._port is not None

    def open(self) -> None:
        """Open the port; a port that is open already is closed first.

        Raises
        ------
        ConfigError
            The URL's scheme is unknown or its form is wrong.
        TransportError
            The port does not open.
        """
        with self._open_lock:  # two threads that stop the table may find the wire broken at once
            self._open()

    def _open(self) -> None:
        self.close()
        url = self.settings.port
        _register_scheme(url)
        try:
            port = serial.serial_for_url(
                url,
                do_not_open=True,
                baudrate=self.settings.baudrate,
                bytesize=self.settings.bytesize,
                parity=self.settings.parity,
                stopbits=self.settings.stopbits,
                rtscts=self.settings.handshake == "rtscts",
                dsrdtr=self.settings.handshake == "dsrdtr",
                xonxoff=self.settings.handshake == "xonxoff",
                timeout=TICK_S,
                write_timeout=None if url.lower().startswith("rfc2217:") else self.settings.timeout_s,  # it has none
                exclusive=self.settings.exclusive,
            )
            if not self._raise_lines:
                port.dtr = False
                port.rts = False
            port.open()
        except (ValueError, NotImplementedError) as exc:
            raise ConfigError(f"{self.device}: port {url!r} cannot be used: {exc}", key=f"{self.device}.port") from exc
        except OPEN_FAULTS as exc:
            raise TransportError(
                f"port {url} does not open ({_reason(exc)}); {_remedy(exc)}", device=self.device
            ) from exc
        self._port = port
        self._buffer.clear()

    def close(self) -> None:
        """Give the port back; harmless when it is closed or gone."""
        port, self._port = self._port, None
        if port is not None:
            peer = getattr(port, "_socket", None)
            # The peer may have gone first, or another thread is in a call: there is nothing left to close.
            with suppress(*OPEN_FAULTS, *CLOSED_MEANWHILE):
                port.close()
            if peer is not None:
                with suppress(OSError):
                    peer.close()  # pyserial forgets to, when the other side hung up first

    def write(self, data: bytes) -> None:
        """Send bytes whole, never interleaved with another thread's."""
        with self._write_lock, self._faults("writing"):
            port = self._open_port()
            port.write(data)
            port.flush()

    def check_open(self) -> None:
        """Raise `TransportError` if the port is not open."""
        self._open_port()

    def set_rts(self, level: bool) -> None:
        """Set the RTS line."""
        with self._faults("setting RTS"):
            self._open_port().rts = level

    def input_line(self, which: Literal["cts", "dsr"]) -> bool:
        """State of an input line."""
        with self._faults(f"reading {which.upper()}"):
            port = self._open_port()
            return bool(port.cts if which == "cts" else port.dsr)

    def read_block(self, most: int) -> bytes:
        """What arrives within one tick, in one call: for streams, where a wake-up per byte would cost too much."""
        with self._faults("reading"):
            taken = bytes(self._buffer) + bytes(self._open_port().read(most))
            self._buffer.clear()
            return taken

    def read_line(self, deadline: float) -> bytes:
        r"""Next line without its ``\r\n`` or ``\n``; empty lines are skipped.

        Parameters
        ----------
        deadline
            `time.monotonic` seconds.

        Raises
        ------
        TransportError
            No whole line came by then; what did come stays in the buffer.
        ProtocolError
            More than `longest_line` bytes came without an end of line (and were thrown away).
        """
        port = self._open_port()
        while True:
            while (end := self._buffer.find(b"\n")) >= 0:
                line = bytes(self._buffer[:end]).strip(b"\r\x00")
                del self._buffer[: end + 1]
                if line:
                    return line
            if len(self._buffer) > self._longest_line:
                start = bytes(self._buffer[:40])
                self._buffer.clear()
                raise ProtocolError(
                    f"sends bytes without an end of line ({start!r}…); check baud rate and that it is this device",
                    device=self.device,
                )
            if time.monotonic() >= deadline:
                got = f"only {bytes(self._buffer[:40])!r}" if self._buffer else "nothing"
                raise TransportError(
                    f"no answer on {self.settings.port} ({got} came); check power, cable and baud rate",
                    device=self.device,
                )
            self._fill(port)

    def discard(self, *, quiet_s: float = 0.05, limit_s: float = 0.5) -> bytes:
        """Throw away what comes until the line was quiet for `quiet_s`, for at most `limit_s`; return it for logs."""
        port = self._open_port()
        thrown = bytearray(self._buffer)
        self._buffer.clear()
        end = time.monotonic() + limit_s
        quiet_at = time.monotonic() + quiet_s
        while time.monotonic() < min(end, quiet_at):
            self._fill(port)
            if self._buffer:
                thrown += self._buffer
                self._buffer.clear()
                quiet_at = time.monotonic() + quiet_s
        return bytes(thrown)

    def _fill(self, port: serial.Serial) -> None:
        if port is not self._port:  # who waits on the old port must not take the new one's answers
            raise TransportError("was opened anew by another call; ask again", device=self.device)
        with self._faults("reading"):
            first = port.read(1)
            if first:
                self._buffer += first
                waiting = port.in_waiting
                if waiting:
                    self._buffer += port.read(waiting)

    def _open_port(self) -> serial.Serial:
        port = self._port  # read once: another thread may close it meanwhile
        if port is None:
            raise TransportError("not connected; connect first", device=self.device)
        return port

    @contextmanager
    def _faults(self, doing: str) -> Iterator[None]:
        try:
            yield
        except serial.SerialTimeoutException as exc:
            raise TransportError(
                f"{self.settings.port} takes no more bytes; is the device on and its handshake as configured?",
                device=self.device,
            ) from exc
        except (*OPEN_FAULTS, *CLOSED_MEANWHILE) as exc:
            if isinstance(exc, OSError) and exc.errno == errno.ENOTTY:
                raise TransportError(f"{self.settings.port} has no such line ({doing})", device=self.device) from exc
            raise TransportError(
                f"connection on {self.settings.port} lost while {doing} ({_reason(exc)}); check cable and power",
                device=self.device,
            ) from exc


def _register_scheme(url: str) -> None:
    scheme, separator, _ = url.lower().partition("://")
    if not separator:
        return
    for found in entry_points(group=URL_GROUP, name=scheme):
        if found.module not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(found.module)


def _remedy(exc: BaseException) -> str:
    """What a person does about a port that does not open."""
    if isinstance(exc, OSError) and exc.errno in (errno.EACCES, errno.EPERM):
        return "add your user to the group that owns the port (mostly dialout), and log in again"
    return "check cable, power and permissions, and that no other program holds it"


def _reason(exc: BaseException) -> str:
    if isinstance(exc, OSError) and exc.strerror:
        return exc.strerror
    return str(exc) or type(exc).__name__
