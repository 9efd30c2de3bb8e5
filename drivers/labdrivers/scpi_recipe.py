"""A SCPI shaker's hard stop as data, for a guardian that has no driver."""

from __future__ import annotations

import re
from importlib.metadata import entry_points

from labdaemon.guardian.recipe import PortSetup, StopRecipe, WireExchange
from labdrivers.scpi_commands import ScpiCommands
from labdrivers.serial_line import URL_GROUP, PortSettings

LONGEST_ANSWER_S = 3.0
"""A try that gets no answer in this time is given up, and the port is opened anew."""
ABOVE_LOWEST = 1.01
"""A level up to this times the lowest is the lowest, as `ScpiShaker.state` reads it."""


def stop_recipe(
    device: str, settings: PortSettings, commands: ScpiCommands, off: str, lowest_level: float
) -> StopRecipe | None:
    """The recipe, or None where another process cannot reach the port (a device simulated in this one).

    Parameters
    ----------
    device
        Name in the rig file.
    off
        The command that switches off, or sets the lowest level where there is none.
    lowest_level
        The controller's level at which a table without output-off rests, in the controller's unit.
    """
    scheme, separator, _ = settings.port.lower().partition("://")
    if separator and (scheme == "loop" or entry_points(group=URL_GROUP, name=scheme)):
        return None
    within_s = min(settings.timeout_s, LONGEST_ANSWER_S)
    handshake = settings.handshake
    return StopRecipe(
        device=device,
        port=settings.port,
        setup=PortSetup(
            settings.baudrate,
            settings.bytesize,
            settings.parity,
            settings.stopbits,
            rtscts=handshake == "rtscts",
            dsrdtr=handshake == "dsrdtr",
            xonxoff=handshake == "xonxoff",
        ),
        stop=(
            WireExchange(b"\n"),  # ends whatever half a command the daemon left
            WireExchange(_line(off), re.escape(commands.acknowledge) if commands.acknowledge else None, None, within_s),
        ),
        identify=WireExchange(_line(commands.identify), within_s=within_s),
        confirm=(_rest(commands, lowest_level, within_s),),
    )


def _rest(commands: ScpiCommands, lowest_level: float, within_s: float) -> WireExchange:
    if commands.get_output:
        off = "|".join(re.escape(reply) for reply in commands.off_replies)
        return WireExchange(_line(commands.get_output), off, None, within_s)
    return WireExchange(_line(commands.get_level), None, lowest_level * ABOVE_LOWEST, within_s)


def _line(command: str) -> bytes:
    return command.encode("ascii") + b"\n"
