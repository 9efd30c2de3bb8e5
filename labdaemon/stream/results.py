"""What commands answer: one frozen model for each, from which clients get objects and the API its schemas."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from labdaemon.events import Event, StatusData
from labdaemon.events.payloads import EventPart


class StatusResult(StatusData):
    """What the daemon does now, and how far its history is.

    Attributes
    ----------
    seq
        The journal's last `seq`; None before there is a journal.
    journal
        UUID of the journal; None before there is one.
    """

    seq: int | None = None
    journal: str | None = None


class ServiceAddresses(EventPart):
    """Where the daemon listens.

    Attributes
    ----------
    commands, events
        Addresses of its sockets.
    data
        Its data folder.
    local_operators
        Who of its machine may come in: what the rig file says, or what follows from the addresses.
    """

    commands: str
    events: str
    data: str | None = None
    local_operators: str | None = None


class RigResult(EventPart):
    """The rig.

    Attributes
    ----------
    version
        Of labdaemon.
    pid
        The daemon's process.
    config
        Path of the rig file.
    service
        Addresses and data folder.
    campaigns
        Folder of all campaigns.
    devices
        Identity of each device, by name.
    cameras, gauges
        Names.
    limits
        The table's limits; None without a shaker.
    interlocks
        The rig file's section.
    """

    version: str
    service: ServiceAddresses
    pid: int | None = None
    config: str | None = None
    campaigns: str | None = None
    devices: Mapping[str, str] = {}
    cameras: tuple[str, ...] = ()
    gauges: tuple[str, ...] = ()
    limits: Mapping[str, Any] | None = None
    interlocks: Mapping[str, Any] = {}


class SubmitResult(EventPart):
    """A campaign that was queued: its id, its data-set folder, and what a person should know before it runs."""

    campaign: str
    folder: str | None = None
    notes: tuple[str, ...] = ()


class CampaignResult(EventPart):
    """The campaign that a command was about: its id."""

    campaign: str


class CampaignSummary(EventPart):
    """A campaign as ``campaign.list`` shows it.

    Attributes
    ----------
    id, name
        Its id, and the name in its file.
    state
        ``queued``, ``running``, ``paused``, ``completed``, ``aborted`` or ``failed``.
    reason
        Why it is paused or has ended.
    submitted_at
        When it was submitted, UTC.
    place
        Place in the queue, 0 for the next one; None for one that does not wait.
    folder, results
        Its data-set folder, and the folder of its results in there.
    """

    id: str
    name: str
    state: str
    reason: str | None = None
    submitted_at: datetime | None = None
    place: int | None = None
    folder: str
    results: str


class CampaignListResult(EventPart):
    """Campaigns, the newest first; ``total`` is how many there are."""

    campaigns: tuple[CampaignSummary, ...]
    total: int


class StepSummary(EventPart):
    """A step that was started: its index from 0, state, number of attempts, and why it was skipped."""

    step: int
    state: str
    attempts: int
    reason: str | None = None


class CampaignShowResult(CampaignSummary):
    """One campaign in full.

    Attributes
    ----------
    toml
        Text of its file.
    steps
        Those that were started.
    captures
        Captures that are stored.
    """

    toml: str
    steps: tuple[StepSummary, ...] = ()
    captures: int = 0


class MoveResult(EventPart):
    """The campaign that was moved, and the queue: ids in the order in which they will run."""

    campaign: str
    queue: tuple[str, ...]


class CaptureReply(EventPart):
    """A capture: its name, and when the shutters opened (None where an outside system has yet to release)."""

    capture: str
    opened_at: datetime | None = None


class EventsResult(EventPart):
    """Events of the journal.

    Attributes
    ----------
    events
        Ascending by `seq`.
    last
        The journal's last `seq`.
    journal
        UUID of the journal.
    gone_before
        First `seq` that is left, where history after the one asked for was cut.
    """

    events: tuple[Event, ...]
    last: int
    journal: str
    gone_before: int | None = None


class DiscoverResult(EventPart):
    """An OpenRPC document: version of the specification, title and version of the API, methods, schemas."""

    openrpc: str
    info: Mapping[str, Any]
    methods: tuple[Mapping[str, Any], ...]
    components: Mapping[str, Any]


class StopResult(EventPart):
    """What a stop led to.

    Attributes
    ----------
    rest
        How the table came to rest.
    table
        ``rest``, ``moving`` or ``unconfirmed``; None without a shaker.
    seen
        What was seen of the table.
    troubles
        What went wrong on the way.
    """

    rest: str
    table: str | None = None
    seen: str | None = None
    troubles: tuple[str, ...] = ()
