"""One frozen model for each kind of event."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Generic, Literal, TypeAlias, TypeVar

from pydantic import Field

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

DataT = TypeVar("DataT")


class EventBase(EventPart, Generic[DataT]):
    """What every event carries.

    Attributes
    ----------
    seq
        Rises by exactly one for each event over a journal's life; a status has the last event's.
    at
        When it was made, UTC.
    kind
        Topic, as ``capture.completed``.
    campaign
        Id of the campaign; None for an event outside any.
    journal
        UUID of the journal that `seq` belongs to.
    data
        What the event says.
    v
        Version of the message.
    """

    seq: int
    at: datetime
    campaign: str | None = None
    journal: str | None = None
    v: int = 1
    data: DataT


class CampaignStarted(EventBase[CampaignData]):
    """A campaign has started."""

    kind: Literal["campaign.started"] = "campaign.started"


class CampaignPaused(EventBase[CampaignData]):
    """A campaign was paused, by a person or after a fault; the table rests."""

    kind: Literal["campaign.paused"] = "campaign.paused"


class CampaignResumed(EventBase[CampaignData]):
    """A paused campaign runs again."""

    kind: Literal["campaign.resumed"] = "campaign.resumed"


class CampaignCompleted(EventBase[CampaignData]):
    """All steps of a campaign have ended, and all its captures are measured."""

    kind: Literal["campaign.completed"] = "campaign.completed"


class CampaignAborted(EventBase[CampaignData]):
    """A person has ended a campaign."""

    kind: Literal["campaign.aborted"] = "campaign.aborted"


class CampaignFailed(EventBase[CampaignData]):
    """A campaign cannot be run."""

    kind: Literal["campaign.failed"] = "campaign.failed"


class StepStarted(EventBase[StepData]):
    """A step has started, for the first time or again."""

    kind: Literal["step.started"] = "step.started"


class StepCompleted(EventBase[StepData]):
    """All captures of a step are stored."""

    kind: Literal["step.completed"] = "step.completed"


class StepSkipped(EventBase[StepData]):
    """A step was left after a fault."""

    kind: Literal["step.skipped"] = "step.skipped"


class StepDecided(EventBase[DecisionData]):
    """A search for modes has chosen the excitation of its next step, or has ended."""

    kind: Literal["step.decided"] = "step.decided"


class CaptureCompleted(EventBase[CaptureData]):
    """All frames of a capture are on disk."""

    kind: Literal["capture.completed"] = "capture.completed"


class EnvelopeMeasured(EventBase[EnvelopeData]):
    """A capture, or a group of captures, is measured."""

    kind: Literal["envelope"] = "envelope"


class FaultReported(EventBase[FaultData]):
    """A device, a disk or an interlock failed."""

    kind: Literal["fault"] = "fault"


class StatusReport(EventBase[StatusData]):
    """What the daemon does now: sent each second, as heartbeat; not kept in the journal."""

    kind: Literal["status"] = "status"


class UnknownEvent(EventBase[Mapping[str, Any]]):
    """An event of a kind that this version does not know: a newer daemon sent it."""

    kind: str


KnownEvent: TypeAlias = Annotated[
    CampaignStarted
    | CampaignPaused
    | CampaignResumed
    | CampaignCompleted
    | CampaignAborted
    | CampaignFailed
    | StepStarted
    | StepCompleted
    | StepSkipped
    | StepDecided
    | CaptureCompleted
    | EnvelopeMeasured
    | FaultReported
    | StatusReport,
    Field(discriminator="kind"),
]

Event: TypeAlias = KnownEvent | UnknownEvent
"""Any event; `isinstance` or ``match`` on the class narrows it."""
