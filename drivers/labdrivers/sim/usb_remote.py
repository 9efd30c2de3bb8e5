"""The simulated USB bus of another process: pyusb's backend here, the cameras there, a connection for each call.

A host process that dies is a host that let go: all it had open and claimed is given back.
"""

from __future__ import annotations

import errno
import socket
import threading
import weakref
from contextlib import suppress
from typing import Any

from labdrivers.sim import messages
from labdrivers.sim.usb_bus import UsbBus, UsbDeviceInfo
from labdrivers.sim.usb_device import UsbFault

SLACK_S = 5.0


class RemoteBus:
    """A `UsbBus` at ``tcp://host:port``.

    Parameters
    ----------
    url
        As the simulator's process prints it.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._free: list[socket.socket] = []
        self._lifeline: list[socket.socket] = []
        """At most one: while it is open the simulator knows that this host lives."""
        self._host: str | None = None
        self._lock = threading.Lock()
        weakref.finalize(self, _close_all, self._free)
        weakref.finalize(self, _close_all, self._lifeline)

    def devices(self) -> list[UsbDeviceInfo]:
        """Everything plugged in; nothing, when the simulator is gone."""
        answer, _ = self._ask({"do": "devices"})
        return [UsbDeviceInfo(**device) for device in answer["devices"]]

    def open(self, address: int) -> int:
        """A handle for a device."""
        return int(self._ask({"do": "open", "address": address})[0]["value"])

    def close(self, handle: int) -> None:
        """Give it back."""
        self._ask({"do": "close", "handle": handle})

    def claim(self, handle: int) -> None:
        """Claim the interface."""
        self._ask({"do": "claim", "handle": handle})

    def release(self, handle: int) -> None:
        """Release it."""
        self._ask({"do": "release", "handle": handle})

    def write(self, handle: int, endpoint: int, data: bytes) -> int:
        """OUT transfer."""
        return int(self._ask({"do": "write", "handle": handle, "endpoint": endpoint}, data)[0]["value"])

    def read(self, handle: int, endpoint: int, size: int, timeout_ms: int) -> bytes:
        """IN transfer."""
        request = {"do": "read", "handle": handle, "endpoint": endpoint, "size": size, "timeout_ms": timeout_ms}
        return self._ask(request, timeout_s=timeout_ms / 1000)[1]

    def control(self, handle: int, request_type: int, request: int, value: int, data: bytes, length: int) -> bytes:
        """Control transfer."""
        head = {
            "do": "control", "handle": handle, "request_type": request_type, "request": request, "value": value,
            "length": length,
        }  # fmt: skip
        return self._ask(head, data)[1]

    def clear_halt(self, handle: int, endpoint: int) -> None:
        """Clear a stall."""
        self._ask({"do": "clear_halt", "handle": handle, "endpoint": endpoint})

    def _ask(self, head: dict[str, Any], data: bytes = b"", *, timeout_s: float = 0.0) -> tuple[dict[str, Any], bytes]:
        peer: socket.socket | None = None
        try:
            peer = self._take()
            peer.settimeout(timeout_s + SLACK_S)
            messages.send(peer, {**head, "host": self._host}, data)
            answer, payload = messages.receive(peer)
        except (OSError, EOFError, ValueError) as exc:
            self._drop(peer)
            raise UsbFault(errno.ENODEV, f"simulator at {self._url} is gone ({exc})") from exc
        with self._lock:
            self._free.append(peer)
        if "errno" in answer:
            raise UsbFault(int(answer["errno"]), str(answer["text"]))
        return answer, payload

    def _take(self) -> socket.socket:
        with self._lock:
            if not self._lifeline:
                lifeline = messages.connect(self._url)
                self._lifeline.append(lifeline)
                messages.send(lifeline, {"do": "hello"})
                self._host = str(messages.receive(lifeline)[0]["host"])
            if self._free:
                return self._free.pop()
        return messages.connect(self._url)

    def _drop(self, peer: socket.socket | None) -> None:
        if peer is not None:
            peer.close()
        with self._lock:
            _close_all(self._free)
            _close_all(self._lifeline)


def _close_all(sockets: list[socket.socket]) -> None:
    for peer in sockets:
        with suppress(OSError):
            peer.close()
    sockets.clear()


class BusServer:
    """Offers a bus to other processes.

    Parameters
    ----------
    bus
        The one to offer.
    """

    def __init__(self, bus: UsbBus, *, host: str = "127.0.0.1", port: int = 0) -> None:
        self._bus = bus
        self._listener = socket.create_server((host, port))
        self.url = f"tcp://{host}:{self._listener.getsockname()[1]}"
        self._handles: dict[str, set[int]] = {}
        self._lock = threading.Lock()
        threading.Thread(target=self._accept, name="usb bus", daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        count = 0
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            count += 1
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._serve, args=(peer, f"host{count}"), daemon=True).start()

    def _serve(self, peer: socket.socket, name: str) -> None:
        lifeline = False
        try:
            while True:
                head, data = messages.receive(peer)
                if head["do"] == "hello":
                    lifeline = True
                    messages.send(peer, {"host": name})
                    continue
                try:
                    answer, payload = self._do(head, data)
                except UsbFault as exc:
                    answer, payload = {"errno": exc.number, "text": str(exc)}, b""
                messages.send(peer, answer, payload)
        except (OSError, EOFError, ValueError, KeyError):
            pass
        finally:
            peer.close()
            if lifeline:
                self._close_handles(name)

    def _close_handles(self, host: str) -> None:
        with self._lock:
            handles = self._handles.pop(host, set())
        for handle in handles:
            self._bus.close(handle)

    def _do(self, head: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
        bus, handle = self._bus, int(head.get("handle", 0))
        match head["do"]:
            case "devices":
                return {"devices": [device.as_dict() for device in bus.devices()]}, b""
            case "open":
                handle = bus.open(int(head["address"]))
                with self._lock:
                    self._handles.setdefault(str(head["host"]), set()).add(handle)
                return {"value": handle}, b""
            case "close":
                bus.close(handle)
                with self._lock:
                    self._handles.get(str(head["host"]), set()).discard(handle)
            case "claim":
                bus.claim(handle)
            case "release":
                bus.release(handle)
            case "write":
                return {"value": bus.write(handle, int(head["endpoint"]), data)}, b""
            case "read":
                return {}, bus.read(handle, int(head["endpoint"]), int(head["size"]), int(head["timeout_ms"]))
            case "control":
                kind, request, value = (int(head[key]) for key in ("request_type", "request", "value"))
                return {}, bus.control(handle, kind, request, value, data, int(head["length"]))
            case "clear_halt":
                bus.clear_halt(handle, int(head["endpoint"]))
            case other:
                raise ValueError(other)
        return {}, b""
