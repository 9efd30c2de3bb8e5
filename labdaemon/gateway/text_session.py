"""Carries out the lines of one client, in order.

``TRIGger`` is overlapped (IEEE 488.2, chapter 12): ``*OPC?``, ``*WAI`` and ``CAPTure?`` wait for it. ``STOP`` waits for
nothing: it is started as soon as its line has come.
"""

from __future__ import annotations

from labdaemon.gateway.client_state import ClientState
from labdaemon.gateway.scpi_errors import ScpiError
from labdaemon.gateway.scpi_syntax import parse_unit, split_line
from labdaemon.gateway.text_commands import TREE, stop_table


def look_ahead(client: ClientState, line: str) -> None:
    """Start what waits for no turn: a line that has just come may hold ``STOP``, while others are still before it."""
    if "stop" not in line.lower():
        return
    try:
        headers = [parse_unit(text).header for text in split_line(line)]
    except ScpiError:  # no command at all, so no stop
        headers = [text.partition(" ")[0].removesuffix("?") for text in line.split(";")]
    if any(_is_stop(header.strip()) for header in headers):
        client.start_stop()


async def run_line(client: ClientState, line: str) -> bytes | None:
    """Carry out a line; the answers of its queries, None where it has none.

    An error ends the line: what comes after it in the same line is not carried out.

    Raises
    ------
    EndOfSession
        The client is to lose its connection.
    """
    parts: list[bytes] = []
    path = ""
    try:
        for text in split_line(line):
            unit = parse_unit(text)
            command, path = TREE.find(unit.header, path)
            command.check(unit, client)
            answer = await command.run(client, unit)
            if answer is not None:
                parts.append(answer if isinstance(answer, bytes) else answer.encode("ascii", "replace"))
    except ScpiError as exc:
        client.record(exc)
    return b";".join(parts) if parts else None


def _is_stop(header: str) -> bool:
    try:
        return TREE.find(header)[0].run is stop_table
    except ScpiError:
        return False
