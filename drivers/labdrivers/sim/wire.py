"""A simulated device on a serial wire, and the ways to reach it: in the process, over a pty, over TCP.

A device takes bytes and sends bytes whenever it likes; it knows nothing of who listens. It keeps its state from one
connection to the next, as a box on a table does.
"""

from __future__ import annotations

import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

from labdrivers.sim.faults import Faults

Send = Callable[[bytes], None]
HangUp = Callable[[], None]


class WireDevice:
    """Base of simulated serial devices: one host at a time; a new one replaces the old."""

    faults: Faults

    def __init__(self) -> None:
        self._send: Send | None = None
        self._hang_up: HangUp | None = None
        self._wire_lock = threading.Lock()
        self._held: bytearray | None = None

    def attach(self, send: Send, hang_up: HangUp) -> None:
        """A host opened the port: `send` carries bytes to it, `hang_up` cuts the connection."""
        with self._wire_lock:
            old, self._send, self._hang_up = self._hang_up, send, hang_up
        if old is not None:
            old()
        faults: Faults | None = getattr(self, "faults", None)  # a test's own device may have none
        if faults is not None and "absent" in faults.table and faults.strike("absent"):
            self.hang_up()
            return
        self.attached()

    def detach(self, send: Send) -> None:
        """That host closed the port (another may have come since)."""
        with self._wire_lock:
            if self._send is not send:
                return
            self._send = self._hang_up = None
        self.detached()

    def attached(self) -> None:
        """Hook: a host is there."""

    def detached(self) -> None:
        """Hook: the host is gone."""

    @property
    def cts(self) -> bool:
        """Level of the host's CTS and DSR inputs."""
        return False

    def set_rts(self, level: bool) -> None:
        """The host's RTS output changed; most devices do not care."""

    def receive(self, data: bytes) -> None:
        """Bytes from the host."""
        raise NotImplementedError

    def send(self, data: bytes) -> None:
        """Bytes to the host, lost when there is none; after those that are late, never before."""
        with self._wire_lock:
            if self._held is not None:
                self._held += data
                return
            send = self._send
        if send is not None:
            with suppress(OSError):
                send(data)

    def send_later(self, delay_s: float, data: bytes) -> None:
        """The same after a while; what is sent meanwhile waits behind it, as a device answers in order."""
        with self._wire_lock:
            if self._held is not None:
                self._held += data
                return
            self._held = bytearray(data)
        timer = threading.Timer(delay_s, self._send_held)
        timer.daemon = True
        timer.start()

    def _send_held(self) -> None:
        with self._wire_lock:
            held, self._held = bytes(self._held or b""), None
        self.send(held)

    def hang_up(self) -> None:
        """Cut the connection, as a pulled plug does."""
        with self._wire_lock:
            cut, self._send, self._hang_up = self._hang_up, None, None
        if cut is not None:
            cut()
            self.detached()

    def shut_down(self) -> None:
        """Stop the device's own threads, if it has any."""


class PtyPort:
    """A device behind a pseudo-terminal; `path` is what a driver opens. Closing it hangs up."""

    def __init__(self, device: WireDevice) -> None:
        self._device = device
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._write = self._send  # one bound method, so that detach can compare it
        device.attach(self._write, self.close)
        self._thread = threading.Thread(target=self._pump, name=f"pty {self.path}", daemon=True)
        self._thread.start()

    def _send(self, data: bytes) -> None:
        while data and not self._stop.is_set():
            data = data[os.write(self._master, data) :]

    def _pump(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], 0.05)
            if ready:
                try:
                    self._device.receive(os.read(self._master, 4096))
                except OSError:
                    return

    def close(self) -> None:
        """Close both ends: who has the port open sees it go."""
        if self._stop.is_set():
            return
        self._stop.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(1)
        self._device.detach(self._write)
        os.close(self._slave)
        os.close(self._master)


class TcpPort:
    """A device behind a TCP port, as a serial server offers it (``socket://host:port``)."""

    def __init__(self, device: WireDevice, *, host: str = "127.0.0.1", port: int = 0) -> None:
        self._device = device
        self._listener = socket.create_server((host, port))
        self.port: int = self._listener.getsockname()[1]
        self.url = f"socket://{host}:{self.port}"
        self._peers: set[socket.socket] = set()
        self._thread = threading.Thread(target=self._accept, name=f"tcp {self.port}", daemon=True)
        self._thread.start()

    def _accept(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._peers.add(peer)
            threading.Thread(target=self._pump, args=(peer,), daemon=True).start()

    def _pump(self, peer: socket.socket) -> None:
        def send(data: bytes) -> None:
            peer.sendall(data)

        def hang_up() -> None:
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)

        self._device.attach(send, hang_up)
        try:
            while data := peer.recv(4096):
                self._device.receive(data)
        except OSError:
            pass
        finally:
            self._device.detach(send)
            self._peers.discard(peer)
            peer.close()

    def close(self) -> None:
        """Stop listening and hang up."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for peer in list(self._peers):
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)
