"""Events as typed objects: one frozen model for each kind, shared by the journal, the client and the documentation.

>>> from labdaemon.events import parse_event
>>> event = parse_event(
...     {"v": 1, "seq": 7, "at": "2026-05-04T10:11:12Z", "kind": "fault", "campaign": None, "journal": "0b6c",
...      "data": {"device": "left", "error": "TransportError", "message": "left: no answer", "action": "retry"}}
... )
>>> event.kind, event.data.device
('fault', 'left')

The daemon makes each event from its model, and the journal stores the model's JSON: what was stated, and nothing that
was left out. Readers ignore
members that they do not know; a kind that they do not know is an `UnknownEvent`. A member that an earlier version did
not write is None.
"""

from labdaemon.events.gauge_motion import GaugeMotion
from labdaemon.events.kinds import (
    CampaignAborted,
    CampaignCompleted,
    CampaignFailed,
    CampaignPaused,
    CampaignResumed,
    CampaignStarted,
    CaptureCompleted,
    EnvelopeMeasured,
    Event,
    FaultReported,
    KnownEvent,
    StatusReport,
    StepCompleted,
    StepDecided,
    StepSkipped,
    StepStarted,
    UnknownEvent,
)
from labdaemon.events.mode_search import DecisionData, ModeEstimate
from labdaemon.events.parse import KINDS, check_payload, event_schema, parse_event
from labdaemon.events.payloads import (
    CampaignData,
    CaptureData,
    EnvelopeData,
    EventPart,
    FaultData,
    FrameFile,
    StatusData,
    StepData,
    TargetRow,
)

__all__ = [
    "KINDS",
    "CampaignAborted",
    "CampaignCompleted",
    "CampaignData",
    "CampaignFailed",
    "CampaignPaused",
    "CampaignResumed",
    "CampaignStarted",
    "CaptureCompleted",
    "CaptureData",
    "DecisionData",
    "EnvelopeData",
    "EnvelopeMeasured",
    "Event",
    "EventPart",
    "FaultData",
    "FaultReported",
    "FrameFile",
    "GaugeMotion",
    "KnownEvent",
    "ModeEstimate",
    "StatusData",
    "StatusReport",
    "StepCompleted",
    "StepData",
    "StepDecided",
    "StepSkipped",
    "StepStarted",
    "TargetRow",
    "UnknownEvent",
    "check_payload",
    "event_schema",
    "parse_event",
]
