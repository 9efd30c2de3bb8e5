"""The answer to ``rpc.discover``: every command and event as an OpenRPC document, from which clients can be made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from labdaemon import __version__
from labdaemon.events import event_schema
from labdaemon.service.capture_parameters import AMPLITUDE_MM, EXPOSURE_S, FREQUENCY_HZ, MAX_TEXT, PHASE_RAD
from labdaemon.stream.publisher import MAX_REPLAY
from labdaemon.tomlfile import MAX_BYTES

Schema: TypeAlias = dict[str, Any]
"""A JSON Schema."""

OPENRPC_VERSION = "1.2.6"
"""Of the specification that the document follows (https://spec.open-rpc.org)."""
EVENT_REFERENCE = "#/components/schemas/"


@dataclass(frozen=True, slots=True)
class MethodDescription:
    """One command.

    Attributes
    ----------
    summary
        What it does, one line.
    params
        JSON Schema of each parameter, by name.
    result
        JSON Schema of each member of the result, by name; other members may come.
    required
        Names of the parameters that must be given.
    """

    summary: str
    params: dict[str, Schema]
    result: dict[str, Schema]
    required: tuple[str, ...] = ()


def _text(description: str, longest: int | None = None) -> Schema:
    return {"type": "string", "description": description} | ({"maxLength": longest} if longest is not None else {})


def _number(description: str, bounds: tuple[float, float]) -> Schema:
    return {"type": "number", "minimum": bounds[0], "maximum": bounds[1], "description": description}


def _or_null(schema: Schema) -> Schema:
    return schema | {"type": [schema["type"], "null"]}


CAMPAIGN = _text("id of the campaign; the current one by default", MAX_TEXT)
REQUEST_ID = _text("makes the command safe to repeat: sent again, it answers the same and does nothing twice", MAX_TEXT)
CAMPAIGN_RESULT = {"campaign": _text("id of the campaign")}
SEQ: Schema = {"type": "integer", "minimum": 0}
EVENTS_RESULT: dict[str, Schema] = {
    "events": {"type": "array", "items": {"$ref": f"{EVENT_REFERENCE}Event"}},
    "last": SEQ | {"description": "the journal's last seq"},
    "journal": _text("UUID of the journal"),
}

METHODS: dict[str, MethodDescription] = {
    "status": MethodDescription(
        "What the daemon does now.", {}, {"seq": SEQ, "journal": _text("UUID of the journal"), "state": _text("state")}
    ),
    "rig": MethodDescription("The rig: devices, cameras, limits, addresses.", {}, {"version": _text("of labdaemon")}),
    "campaign.submit": MethodDescription(
        "Queue a campaign.",
        {"toml": _text("text of the campaign file", MAX_BYTES), "request_id": REQUEST_ID},
        CAMPAIGN_RESULT | {"folder": _text("the campaign's data-set folder")},
        required=("toml",),
    ),
    "campaign.pause": MethodDescription("Bring the table to rest and wait.", {"campaign": CAMPAIGN}, CAMPAIGN_RESULT),
    "campaign.resume": MethodDescription(
        "Continue a paused campaign.",
        {
            "campaign": CAMPAIGN,
            "accept_changed_rig": {"type": "boolean", "description": "also where the rig file has changed since"},
        },
        CAMPAIGN_RESULT,
    ),
    "campaign.abort": MethodDescription("End a campaign for good.", {"campaign": CAMPAIGN}, CAMPAIGN_RESULT),
    "capture": MethodDescription(
        "Fire all shutters once; answers when they have opened.",
        {
            "label": _text("part of the capture's name", MAX_TEXT),
            "sharp": {"type": "boolean", "description": "a sharp frame, taken at rest"},
            "request_id": REQUEST_ID,
            "frequency_hz": _number("excitation frequency, hertz", FREQUENCY_HZ),
            "excitation_amplitude_mm": _number("amplitude of the table, zero to peak, millimetres", AMPLITUDE_MM),
            "phase_rad": _number("excitation phase at the opening, radians", PHASE_RAD),
            "group": _text("captures of one group are measured together", MAX_TEXT),
            "exposure_s": _number("exposure time, seconds", EXPOSURE_S),
        },
        {
            "capture": _text("name of the capture"),
            "opened_at": _or_null(_text("opening of the shutters, RFC 3339 UTC")),
        },
    ),
    "events.replay": MethodDescription(
        "Events after a seq, ascending; ask until `last` is reached.",
        {"after": SEQ | {"default": 0}, "limit": SEQ | {"default": MAX_REPLAY}},
        EVENTS_RESULT | {"gone_before": SEQ | {"description": "first seq that is left, where history was cut"}},
    ),
    "events.latest": MethodDescription("The last event of each kind.", {}, EVENTS_RESULT),
    "rpc.discover": MethodDescription("This document.", {}, {"openrpc": _text("version of the specification")}),
    "stop": MethodDescription(
        "Bring the shaker to rest now; parameters of any name are accepted.",
        {},
        {
            "rest": _text("how it came to rest"),
            "table": _or_null(_text("rest, moving or unconfirmed; null without a shaker")),
            "seen": _or_null(_text("what was seen of the table")),
            "troubles": {"type": "array", "items": {"type": "string"}},
        },
    ),
}
"""Every command that the daemon answers."""


@cache
def openrpc_document() -> dict[str, Any]:
    """The OpenRPC document of this version. The caller must not change it."""
    events = event_schema(EVENT_REFERENCE)
    schemas = events.pop("$defs")
    return {
        "openrpc": OPENRPC_VERSION,
        "info": {"title": "labdaemon", "version": __version__},
        "methods": [_method(name, method) for name, method in METHODS.items()],
        "components": {"schemas": schemas | {"Event": events}},
    }


def _method(name: str, method: MethodDescription) -> dict[str, Any]:
    return {
        "name": name,
        "summary": method.summary,
        "paramStructure": "by-name",
        "params": [
            {"name": param, "required": param in method.required, "schema": schema}
            for param, schema in method.params.items()
        ],
        "result": {"name": "result", "schema": {"type": "object", "properties": method.result}},
    }
