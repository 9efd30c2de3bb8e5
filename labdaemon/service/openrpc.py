"""The answer to ``rpc.discover``: every command and event as an OpenRPC document, from which clients can be made."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from pydantic.json_schema import models_json_schema

from labdaemon.campaign.manual_request import AMPLITUDE_MM, EXPOSURE_S, FREQUENCY_HZ, MAX_TEXT, PHASE_RAD
from labdaemon.events import event_schema
from labdaemon.events.payloads import EventPart
from labdaemon.service.campaign_queries import MOST_LISTED
from labdaemon.stream import messages, results
from labdaemon.stream.publisher import MAX_REPLAY
from labdaemon.stream.roles import OBSERVER_COMMANDS
from labdaemon.tomlfile import MAX_BYTES
from labdaemon.version import __version__

Schema: TypeAlias = dict[str, Any]
"""A JSON Schema."""

OPENRPC_VERSION = "1.2.6"
"""Of the specification that the document follows (https://spec.open-rpc.org)."""
REFERENCE = "#/components/schemas/"
"""Where the schemas lie in the document."""


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
        Model of what it answers; other members may come.
    required
        Names of the parameters that must be given.
    """

    summary: str
    params: dict[str, Schema]
    result: type[EventPart]
    required: tuple[str, ...] = ()


def _text(description: str, longest: int | None = None) -> Schema:
    return {"type": "string", "description": description} | ({"maxLength": longest} if longest is not None else {})


def _number(description: str, bounds: tuple[float, float]) -> Schema:
    return {"type": "number", "minimum": bounds[0], "maximum": bounds[1], "description": description}


CAMPAIGN = _text("id of the campaign; the current one by default", MAX_TEXT)
REQUEST_ID = _text("makes the command safe to repeat: sent again, it answers the same and does nothing twice", MAX_TEXT)
SEQ: Schema = {"type": "integer", "minimum": 0}

METHODS: dict[str, MethodDescription] = {
    "status": MethodDescription("What the daemon does now.", {}, results.StatusResult),
    "rig": MethodDescription("The rig: devices, cameras, limits, addresses.", {}, results.RigResult),
    "campaign.submit": MethodDescription(
        "Queue a campaign.",
        {"toml": _text("text of the campaign file", MAX_BYTES), "request_id": REQUEST_ID},
        results.SubmitResult,
        required=("toml",),
    ),
    "campaign.pause": MethodDescription(
        "Bring the table to rest and wait.", {"campaign": CAMPAIGN}, results.CampaignResult
    ),
    "campaign.resume": MethodDescription(
        "Continue a paused campaign.",
        {
            "campaign": CAMPAIGN,
            "accept_changed_rig": {"type": "boolean", "description": "also where the rig file has changed since"},
        },
        results.CampaignResult,
    ),
    "campaign.abort": MethodDescription("End a campaign for good.", {"campaign": CAMPAIGN}, results.CampaignResult),
    "campaign.list": MethodDescription(
        "Campaigns, the newest first; those that wait or run are always among them.",
        {"limit": {"type": "integer", "minimum": 1, "maximum": MOST_LISTED, "default": 100}},
        results.CampaignListResult,
    ),
    "campaign.show": MethodDescription(
        "One campaign in full, with the folder of its results.", {"campaign": CAMPAIGN}, results.CampaignShowResult
    ),
    "campaign.move": MethodDescription(
        "Give a queued campaign another place in the queue.",
        {
            "campaign": _text("id of the campaign", MAX_TEXT),
            "place": SEQ | {"default": 0, "description": "its place, counted from 0, the next one"},
        },
        results.MoveResult,
        required=("campaign",),
    ),
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
        results.CaptureReply,
    ),
    "events.replay": MethodDescription(
        "Events after a seq, ascending; ask until `last` is reached.",
        {"after": SEQ | {"default": 0}, "limit": SEQ | {"default": MAX_REPLAY}},
        results.EventsResult,
    ),
    "events.latest": MethodDescription("The last event of each kind.", {}, results.EventsResult),
    "rpc.discover": MethodDescription("This document.", {}, results.DiscoverResult),
    "stop": MethodDescription(
        "Bring the shaker to rest now; parameters of any name are accepted.", {}, results.StopResult
    ),
}
"""Every command that the daemon answers."""


@cache
def openrpc_document() -> dict[str, Any]:
    """The OpenRPC document of this version. The caller must not change it."""
    return {
        "openrpc": OPENRPC_VERSION,
        "info": {"title": "labdaemon", "version": __version__},
        "methods": [_method(name, method) for name, method in METHODS.items()],
        "components": {"schemas": all_schemas(REFERENCE), "errors": ERRORS},
    }


ERRORS: dict[str, dict[str, Any]] = {
    name: {"code": code, "message": name, "data": {"name": name}} for code, name in sorted(messages.NAMES.items())
}
"""Errors by the word in their ``data.name``."""


def all_schemas(reference: str) -> dict[str, Any]:
    """JSON Schemas by name: each event, ``Event`` for any of them, and what each command answers.

    Parameters
    ----------
    reference
        Where they lie in the document that they are for, with a slash at its end.
    """
    events = event_schema(reference)
    schemas: dict[str, Any] = events.pop("$defs")
    models = sorted({method.result for method in METHODS.values()}, key=lambda model: model.__name__)
    _, made = models_json_schema([(model, "serialization") for model in models], ref_template=reference + "{model}")
    schemas |= made["$defs"]
    return dict(sorted(schemas.items())) | {"Event": events}


def _method(name: str, method: MethodDescription) -> dict[str, Any]:
    return {
        "name": name,
        "summary": method.summary,
        "paramStructure": "by-name",
        "params": [
            {"name": param, "required": param in method.required, "schema": schema}
            for param, schema in method.params.items()
        ],
        "result": {"name": "result", "schema": {"$ref": REFERENCE + method.result.__name__}},
        "x-role": "observer" if name in OBSERVER_COMMANDS else "operator",
    }
