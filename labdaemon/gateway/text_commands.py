"""Every command of the text gateway, and what it does."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from labdaemon.gateway import answers
from labdaemon.gateway.capture_settings import PARAMETERS, StatedParameter
from labdaemon.gateway.client_state import ClientState
from labdaemon.gateway.scpi_errors import ScpiError
from labdaemon.gateway.scpi_syntax import HeaderTree, ProgramUnit, block, read_number, read_text
from labdaemon.off_loop import off_loop
from labdaemon.stream.command_call import last_of_kind

NEXT_S = 60.0
"""How long ``ENVelope:NEXT?`` waits where the client does not say."""
LONGEST_WAIT_S = 3600.0
SCPI_VERSION = "1999.0"

Answer: TypeAlias = str | bytes | None
Run: TypeAlias = Callable[[ClientState, ProgramUnit], Awaitable[Answer]]


@dataclass(frozen=True, slots=True)
class SessionCommand:
    """A command, a query, or both under one header.

    Attributes
    ----------
    run
        Carries it out.
    has_action, has_query
        Whether it exists without and with a question mark.
    parameters, query_parameters
        Fewest and most.
    is_open
        It needs no token.
    """

    run: Run
    has_action: bool = False
    has_query: bool = False
    parameters: tuple[int, int] = (0, 0)
    query_parameters: tuple[int, int] = (0, 0)
    is_open: bool = False

    def check(self, unit: ProgramUnit, client: ClientState) -> None:
        """Refuse what the command is not, or the client may not.

        Raises
        ------
        ScpiError
            -113, -108, -109 or -203.
        """
        if unit.is_query and not self.has_query:
            raise ScpiError(-113, f"{unit.header}? (it is no query)")
        if not unit.is_query and not self.has_action:
            raise ScpiError(-113, f"{unit.header} (only the query exists)")
        fewest, most = self.query_parameters if unit.is_query else self.parameters
        if len(unit.parameters) < fewest:
            raise ScpiError(-109, unit.header)
        if len(unit.parameters) > most:
            raise ScpiError(-108, unit.header)
        if client.role is None and not self.is_open:
            raise ScpiError(-203, "say AUTH with the token first")

    def spelling(self, pattern: str) -> str:
        """As ``SYSTem:HELP?`` lists it."""
        return pattern + ("" if not self.has_query else "[?]" if self.has_action else "?")


async def _identity(client: ClientState, unit: ProgramUnit) -> Answer:
    return client.context.identity


async def _auth(client: ClientState, unit: ProgramUnit) -> Answer:
    await client.authorise(read_text(unit.parameters[0]))
    return None


async def _clear(client: ClientState, unit: ProgramUnit) -> Answer:
    client.clear()
    return None


async def _reset(client: ClientState, unit: ProgramUnit) -> Answer:
    client.settings.clear()
    return None


async def _complete(client: ClientState, unit: ProgramUnit) -> Answer:
    if unit.is_query:
        await client.uninterrupted(client.all_fired())
        return "1"
    client.want_complete()
    return None


async def _wait(client: ClientState, unit: ProgramUnit) -> Answer:
    await client.all_fired()
    return None


async def _self_test(client: ClientState, unit: ProgramUnit) -> Answer:
    return "0"


async def _event_status(client: ClientState, unit: ProgramUnit) -> Answer:
    value, client.event_status = client.event_status, 0
    return str(value)


async def _enable(client: ClientState, unit: ProgramUnit) -> Answer:
    name = unit.header.upper()
    if unit.is_query:
        return str(client.enabled[name])
    value = round(read_number(unit.parameters[0], {}))
    if not 0 <= value <= 255:
        raise ScpiError(-222, f"{name} is a number from 0 to 255")
    client.enabled[name] = value
    return None


async def _status_byte(client: ClientState, unit: ProgramUnit) -> Answer:
    value = 4 * bool(client.errors) | 32 * bool(client.event_status & client.enabled["*ESE"])
    return str(value | 64 * bool(value & client.enabled["*SRE"] & ~64))


async def _trigger(client: ClientState, unit: ProgramUnit) -> Answer:
    params = client.settings.params()
    if unit.parameters:
        params["label"] = read_text(unit.parameters[0])
    await client.trigger(params)
    return None


def _stated(parameter: StatedParameter) -> Run:
    async def run(client: ClientState, unit: ProgramUnit) -> Answer:
        if unit.is_query:
            return client.settings.query(parameter)
        client.settings.set(parameter, unit.parameters[0])
        return None

    return run


async def _capture(client: ClientState, unit: ProgramUnit) -> Answer:
    await client.uninterrupted(client.all_fired())
    if client.fired is not None:
        return answers.capture_text(*client.fired)
    event = await _last(client, "capture.completed")
    data = event["data"] if event is not None else {}
    return answers.capture_text(data.get("capture"), data.get("opened_at"))


async def _last(client: ClientState, kind: str) -> dict[str, Any] | None:
    result = await client.call("events.latest")
    return last_of_kind(result["events"], kind)


async def _envelope(client: ClientState, unit: ProgramUnit) -> Answer:
    event = await _last(client, "envelope")
    if not unit.parameters:
        return await off_loop(answers.envelope_text, event)
    name = read_text(unit.parameters[0])
    row = answers.find_target(event, name)
    if row is None:
        raise ScpiError(-230, f"the last envelope has no target {name[:40]}")
    return answers.target_text(row)


async def _envelope_csv(client: ClientState, unit: ProgramUnit) -> Answer:
    return await off_loop(answers.envelope_csv_block, await _last(client, "envelope"))


async def _envelope_json(client: ClientState, unit: ProgramUnit) -> Answer:
    return await off_loop(answers.envelope_json_block, await _last(client, "envelope"))


async def _next_envelope(client: ClientState, unit: ProgramUnit) -> Answer:
    limit_s = read_number(unit.parameters[0], {"S": 1.0}) if unit.parameters else NEXT_S
    if not 0.0 <= limit_s <= LONGEST_WAIT_S:
        raise ScpiError(-222, f"a wait is from 0 to {LONGEST_WAIT_S:g} s")
    try:
        async with asyncio.timeout(limit_s):
            await client.uninterrupted(_until_next(client, "envelope"))
    except TimeoutError:  # the device language has no other way to say that none came
        return answers.envelope_text(None)
    return await off_loop(answers.envelope_text, await _last(client, "envelope"))


async def _until_next(client: ClientState, kind: str) -> None:
    """Wait for an event of a kind that is committed from now on."""
    feed = client.context.feed
    seq = feed.last_seq
    while True:
        events = await feed.after(seq)
        if any(event.kind == kind for event in events):
            return
        seq = events[-1].seq


async def _status(client: ClientState, unit: ProgramUnit) -> Answer:
    return answers.status_text(await client.call("status"))


async def _operation(client: ClientState, unit: ProgramUnit) -> Answer:
    return str(answers.operation_bits(await client.call("status")))


async def stop_table(client: ClientState, unit: ProgramUnit) -> Answer:
    """``STOP``, and ``STOP?``, which answers the state of the table."""
    result = await client.stop()
    return str(result.get("table") or "none").upper() if unit.is_query else None


async def _error(client: ClientState, unit: ProgramUnit) -> Answer:
    return client.errors.take()


async def _all_errors(client: ClientState, unit: ProgramUnit) -> Answer:
    return client.errors.take_all()


async def _error_count(client: ClientState, unit: ProgramUnit) -> Answer:
    return str(len(client.errors))


async def _version(client: ClientState, unit: ProgramUnit) -> Answer:
    return SCPI_VERSION


async def _help(client: ClientState, unit: ProgramUnit) -> Answer:
    return ",".join(command.spelling(pattern) for pattern, command in COMMANDS)


async def _headers(client: ClientState, unit: ProgramUnit) -> Answer:
    lines = []
    for pattern, command in COMMANDS:
        lines.append(pattern + ("?/qonly/" if not command.has_action else "" if command.has_query else "/nquery/"))
    return block(("\n".join(lines) + "\n").encode())


def _action(run: Run, *, parameters: tuple[int, int] = (0, 0), is_open: bool = False) -> SessionCommand:
    return SessionCommand(run, has_action=True, parameters=parameters, is_open=is_open)


def _query(run: Run, *, parameters: tuple[int, int] = (0, 0), is_open: bool = False) -> SessionCommand:
    return SessionCommand(run, has_query=True, query_parameters=parameters, is_open=is_open)


def _both(run: Run, parameters: tuple[int, int] = (1, 1)) -> SessionCommand:
    return SessionCommand(run, has_action=True, has_query=True, parameters=parameters)


COMMANDS: tuple[tuple[str, SessionCommand], ...] = (
    ("*IDN", _query(_identity, is_open=True)),
    ("*CLS", _action(_clear, is_open=True)),
    ("*RST", _action(_reset)),
    ("*OPC", _both(_complete, (0, 0))),
    ("*WAI", _action(_wait)),
    ("*TST", _query(_self_test)),
    ("*ESR", _query(_event_status)),
    ("*ESE", _both(_enable)),
    ("*SRE", _both(_enable)),
    ("*STB", _query(_status_byte)),
    ("*TRG", _action(_trigger)),
    ("AUTH", _action(_auth, parameters=(1, 1), is_open=True)),
    ("TRIGger[:IMMediate]", _action(_trigger, parameters=(0, 1))),
    ("CAPTure", _query(_capture)),
    *((f"CAPTure:{mnemonic}", _both(_stated(parameter))) for mnemonic, parameter in PARAMETERS.items()),
    ("ENVelope", _query(_envelope, parameters=(0, 1))),
    ("ENVelope:CSV", _query(_envelope_csv)),
    ("ENVelope:JSON", _query(_envelope_json)),
    ("ENVelope:NEXT", _query(_next_envelope, parameters=(0, 1))),
    ("STATus", _query(_status)),
    ("STATus:OPERation[:CONDition]", _query(_operation)),
    ("STOP", _both(stop_table, (0, 0))),
    ("SYSTem:ERRor[:NEXT]", _query(_error, is_open=True)),
    ("SYSTem:ERRor:ALL", _query(_all_errors, is_open=True)),
    ("SYSTem:ERRor:COUNt", _query(_error_count, is_open=True)),
    ("SYSTem:VERSion", _query(_version, is_open=True)),
    ("SYSTem:HELP", _query(_help, is_open=True)),
    ("SYSTem:HELP:HEADers", _query(_headers, is_open=True)),
)
"""Every command by its header's pattern."""
TREE: HeaderTree[SessionCommand] = HeaderTree(COMMANDS)
"""Finds them."""
