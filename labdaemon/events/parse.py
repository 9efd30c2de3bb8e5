"""Between JSON and typed events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from labdaemon.errors import DataError
from labdaemon.events.kinds import Event, KnownEvent, UnknownEvent
from labdaemon.events.mode_search import DecisionData
from labdaemon.events.payloads import (
    CampaignData,
    CaptureData,
    EnvelopeData,
    EventPart,
    FaultData,
    StatusData,
    StepData,
)

_PAYLOADS: Mapping[str, type[EventPart]] = {
    "campaign.started": CampaignData,
    "campaign.paused": CampaignData,
    "campaign.resumed": CampaignData,
    "campaign.completed": CampaignData,
    "campaign.aborted": CampaignData,
    "campaign.failed": CampaignData,
    "step.started": StepData,
    "step.completed": StepData,
    "step.skipped": StepData,
    "step.decided": DecisionData,
    "capture.completed": CaptureData,
    "envelope": EnvelopeData,
    "fault": FaultData,
    "status": StatusData,
}
KINDS = tuple(_PAYLOADS)
"""Every kind of event that this version sends."""

_known: TypeAdapter[KnownEvent] = TypeAdapter(KnownEvent)


def parse_event(message: Mapping[str, Any] | str | bytes) -> Event:
    """A message of the event stream, or of ``events.replay``, as a typed object.

    Parameters
    ----------
    message
        The event as a dict, or its JSON.

    Raises
    ------
    DataError
        It is no event, or a member has another type than this version knows.
    """
    try:
        parsed = from_json(message) if isinstance(message, str | bytes) else message
        if not isinstance(parsed, Mapping):
            raise DataError("this is no event: an event is a JSON object")
        kind = parsed.get("kind")
        if isinstance(kind, str) and kind in _PAYLOADS:
            return _known.validate_python(parsed)
        return UnknownEvent.model_validate(parsed)
    except ValidationError as exc:
        raise DataError(f"this is no event: {_first_mistake(exc)}") from exc
    except ValueError as exc:
        raise DataError(f"this is no event: {exc}") from exc


def check_payload(kind: str, data: EventPart) -> None:
    """Check that this is what an event of the kind says, when the event is made.

    Raises
    ------
    ValueError
        No event has this kind, or its ``data`` is of another model: a mistake in the program.
    """
    model = _PAYLOADS.get(kind)
    if model is None:
        raise ValueError(f"no event has the kind {kind!r}")
    if type(data) is not model:
        raise ValueError(f"an event {kind!r} carries {model.__name__}, not {type(data).__name__}")


def event_schema(reference: str = "#/$defs/") -> dict[str, Any]:
    """JSON Schema of every event.

    Parameters
    ----------
    reference
        Where the parts, which are in ``$defs``, lie in the document that the schema is for.
    """
    return _known.json_schema(mode="serialization", ref_template=reference + "{model}")


def _first_mistake(exc: ValidationError) -> str:
    mistake = exc.errors(include_url=False, include_input=False)[0]
    place = ".".join(str(part) for part in mistake["loc"])
    return f"{place}: {mistake['msg']}" if place else str(mistake["msg"])
