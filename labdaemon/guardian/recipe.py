"""How to stop a shaker without its driver: a port, bytes to send, and the answers that mean rest.

A driver makes one (`labdaemon.capture.devices.StopRecipeSource`); it goes to the guardian as one line of JSON.
"""

from __future__ import annotations

import json
from typing import Any, NamedTuple


class PortSetup(NamedTuple):
    """What pyserial needs to open the port, under pyserial's own names."""

    baudrate: int = 115200
    bytesize: int = 8
    parity: str = "N"
    stopbits: int = 1
    rtscts: bool = False
    dsrdtr: bool = False
    xonxoff: bool = False


class WireExchange(NamedTuple):
    """Bytes to send, and what is expected back.

    Attributes
    ----------
    send
        With the end of line that the device wants.
    answer
        Regular expression that the whole answer (a line without its end, as Latin-1) must match, in any case of
        letters; None where the device answers nothing.
    at_most
        Upper limit of the size of the answer's first number; None for no limit.
    within_s
        Longest wait for the answer, seconds.
    """

    send: bytes
    answer: str | None = None
    at_most: float | None = None
    within_s: float = 1.0


class StopRecipe(NamedTuple):
    """All that is needed to stop one shaker hard, and to see it at rest.

    Attributes
    ----------
    device
        Name in the rig file.
    port
        As `serial.serial_for_url` takes it.
    setup
        Settings of the port.
    stop
        Sent in turn, whatever is answered: output off, in every state of the device.
    identify
        A question whose answer never changes. It is asked until the same answer came twice running, so that a late
        answer to the daemon is not taken for an answer to `confirm`. None where the protocol numbers its answers.
    confirm
        The table rests when every one of these is answered as expected.
    line_end
        Ends an answer.
    """

    device: str
    port: str
    setup: PortSetup
    stop: tuple[WireExchange, ...]
    identify: WireExchange | None
    confirm: tuple[WireExchange, ...]
    line_end: bytes = b"\n"


def to_json(recipe: StopRecipe) -> dict[str, Any]:
    """The recipe as a JSON object; bytes become Latin-1 text."""
    return {
        "device": recipe.device,
        "port": recipe.port,
        "setup": recipe.setup._asdict(),
        "stop": [_plain(exchange) for exchange in recipe.stop],
        "identify": _plain(recipe.identify) if recipe.identify is not None else None,
        "confirm": [_plain(exchange) for exchange in recipe.confirm],
        "line_end": recipe.line_end.decode("latin-1"),
    }


def from_json(found: dict[str, Any]) -> StopRecipe:
    """The recipe that `to_json` wrote.

    Raises
    ------
    KeyError, TypeError
        It is none.
    """
    return StopRecipe(
        found["device"],
        found["port"],
        PortSetup(**found["setup"]),
        tuple(_exchange(each) for each in found["stop"]),
        _exchange(found["identify"]) if found["identify"] is not None else None,
        tuple(_exchange(each) for each in found["confirm"]),
        found["line_end"].encode("latin-1"),
    )


def read_message(line: bytes) -> dict[str, Any]:
    """One line of the pipe as an object; an empty one where it is none (a writer that died in mid-line)."""
    try:
        found = json.loads(line)
    except ValueError:  # half a line: the pipe's end says the rest
        return {}
    return found if isinstance(found, dict) else {}


def _plain(exchange: WireExchange) -> dict[str, Any]:
    return exchange._asdict() | {"send": exchange.send.decode("latin-1")}


def _exchange(found: dict[str, Any]) -> WireExchange:
    return WireExchange(found["send"].encode("latin-1"), found["answer"], found["at_most"], found["within_s"])
