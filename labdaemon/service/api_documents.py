"""The API as public documents: OpenRPC for commands, AsyncAPI for events, JSON Schema for both."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from labdaemon.events import KINDS
from labdaemon.service.openrpc import METHODS, REFERENCE, all_schemas, openrpc_document
from labdaemon.stream.client import COMMANDS, EVENTS
from labdaemon.version import __version__

ASYNCAPI_VERSION = "3.0.0"
DRAFT = "https://json-schema.org/draft/2020-12/schema"
ABOUT = "Events and commands of labdaemon, a lab acquisition daemon for vibration from motion blur."


def asyncapi_document() -> dict[str, Any]:
    """The events as an AsyncAPI document: one channel, and one ZeroMQ topic, for each kind."""
    schemas = all_schemas(REFERENCE)
    names = schemas["Event"]["discriminator"]["mapping"]
    models = {kind: names[kind].removeprefix(REFERENCE) for kind in KINDS}
    return {
        "asyncapi": ASYNCAPI_VERSION,
        "info": {"title": "labdaemon", "version": __version__, "description": ABOUT},
        "defaultContentType": "application/json",
        "servers": {
            "events": {
                "host": EVENTS.removeprefix("tcp://"),
                "protocol": "zmq",
                "description": "An XPUB socket: connect with SUB. Two frames: the kind as topic, then JSON.",
            },
            "commands": {
                "host": COMMANDS.removeprefix("tcp://"),
                "protocol": "zmq",
                "description": "A ROUTER socket for JSON-RPC 2.0 from DEALER or REQ; see the OpenRPC document.",
            },
        },
        "channels": {
            model: {
                "address": kind,
                "servers": [{"$ref": "#/servers/events"}],
                "messages": {model: {"$ref": f"#/components/messages/{model}"}},
            }
            for kind, model in models.items()
        },
        "operations": {
            f"send{model}": {"action": "send", "channel": {"$ref": f"#/channels/{model}"}} for model in models.values()
        },
        "components": {
            "messages": {
                model: {
                    "name": kind,
                    "contentType": "application/json",
                    "summary": " ".join(schemas[model].get("description", kind).split("\n\n")[0].split()),
                    "payload": {"$ref": REFERENCE + model},
                }
                for kind, model in models.items()
            },
            "schemas": schemas,
        },
    }


def jsonschema_document() -> dict[str, Any]:
    """One JSON Schema (2020-12): an event is what it describes, and ``$defs`` has all parts, parameters and results."""
    schemas = all_schemas("#/$defs/")
    event = schemas.pop("Event")
    params = {f"{name} params": _params(name) for name in METHODS}
    return {
        "$schema": DRAFT,
        "$id": f"urn:labdaemon:{__version__}:event",
        "title": "labdaemon event",
        "$defs": schemas | params,
        **event,
    }


def _params(name: str) -> dict[str, Any]:
    """The parameters of a command, as one object."""
    method = METHODS[name]
    return {
        "type": "object",
        "description": method.summary,
        "properties": dict(method.params),
        "required": list(method.required),
        "additionalProperties": name == "stop",  # nothing may keep the table from being stopped
    }


DOCUMENTS: Mapping[str, Callable[[], dict[str, Any]]] = {
    "openrpc": openrpc_document,
    "asyncapi": asyncapi_document,
    "jsonschema": jsonschema_document,
}
"""What makes each document."""


def document_text(name: str) -> str:
    """A document as it is printed and kept in the repository: always the same text for the same API."""
    return json.dumps(DOCUMENTS[name](), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
