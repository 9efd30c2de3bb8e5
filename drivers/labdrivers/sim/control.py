"""The simulator's back door for tests and demo: its truth, its faults, its plugs. A daemon never uses it."""

from __future__ import annotations

import json
import socket
import socketserver
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from labdaemon.clock import rfc3339
from labdrivers.sim import messages
from labdrivers.sim.assembly import SimulatedRig


class ControlCommands:
    """Answers questions about a simulated rig.

    Parameters
    ----------
    rig
        The rig.
    quit_now
        What ``quit`` calls.
    """

    def __init__(self, rig: SimulatedRig, quit_now: Callable[[], None]) -> None:
        self._rig, self._quit = rig, quit_now

    def do(self, request: dict[str, Any]) -> Any:
        """Serve one request; raises `ValueError` or `KeyError` for one that makes no sense."""
        rig = self._rig
        match request.get("do"):
            case "table":
                return self._table()
            case "records":
                return [{**record, "opened_at": self._wall(record["opened_s"])} for record in rig.rig.records]
            case "cards":
                return {name: self._card(name) for name in rig.bus.cameras}
            case "faults":
                return {name: {f: d for s in found for f, d in s.table.items()} for name, found in rig.faults().items()}
            case "inject":
                self._inject(request)
            case "clear":
                for name, switches in rig.faults().items():
                    if request.get("device") in (None, name):
                        for switch in switches:
                            switch.clear(request.get("fault"))
            case "unplug":
                rig.bus.unplug(request["device"])
            case "plug":
                return rig.bus.plug(request["device"])
            case "hang_up":
                rig.wires[request["device"]].hang_up()
            case "edge":
                rig.trigger.external_edge()
            case "quit":
                threading.Timer(0.1, self._quit).start()  # after the answer
            case other:
                raise ValueError(f"no request {other!r}")
        return True

    def _inject(self, request: dict[str, Any]) -> None:
        found = [s for s in self._rig.faults()[request["device"]] if request["fault"] in s.table]
        if not found:
            raise KeyError(f"{request['device']} has no fault {request['fault']!r}")
        found[0].inject(request["fault"], count=request.get("count"), value=request.get("value"))

    def _table(self) -> dict[str, Any]:
        now = self._rig.clock()
        rig = self._rig.rig
        return {
            "moving": rig.moving(now),
            "frequency_hz": rig.frequency_hz(now),
            "enabled": rig.enabled,
            "tripped": rig.tripped,
        }

    def _card(self, name: str) -> list[str]:
        card = self._rig.bus.cameras[name].body.card
        items = (card.get(handle) for handle in card.handles())
        return [item.name for item in items if item is not None and item.path is not None]

    def _wall(self, t: float) -> str:
        return rfc3339(datetime.fromtimestamp(time.time() + t - self._rig.clock(), UTC))


class ControlServer:
    """Offers a `ControlCommands` over TCP, one message each way a request."""

    def __init__(self, control: ControlCommands) -> None:
        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                while True:
                    try:
                        request, _ = messages.receive(self.request)
                    except (OSError, EOFError, json.JSONDecodeError):
                        return
                    try:
                        answer = {"result": control.do(request)}
                    except (ValueError, KeyError) as exc:
                        answer = {"error": str(exc)}
                    messages.send(self.request, answer)

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            allow_reuse_address = True

        self._server = Server(("127.0.0.1", 0), Handler)
        self.url = f"tcp://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, name="control", daemon=True).start()

    def close(self) -> None:
        """Stop."""
        self._server.shutdown()
        self._server.server_close()


class ControlClient:
    """The other end.

    Parameters
    ----------
    url
        As the simulator's process prints it.
    """

    def __init__(self, url: str) -> None:
        self._peer = messages.connect(url)
        self._lock = threading.Lock()

    def ask(self, do: str, **arguments: Any) -> Any:
        """One request; raises `ValueError` with the simulator's own words when it makes no sense."""
        with self._lock:
            messages.send(self._peer, {"do": do, **arguments})
            answer, _ = messages.receive(self._peer)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer["result"]

    def close(self) -> None:
        """Hang up."""
        self._peer.shutdown(socket.SHUT_RDWR)
        self._peer.close()
