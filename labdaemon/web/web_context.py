"""What the routes of the web server share."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from labdaemon.stream.command_call import Execute
from labdaemon.stream.event_feed import EventFeed
from labdaemon.stream.peer_log import PeerLog
from labdaemon.web.guard import WebAccess


@dataclass(slots=True)
class WebContext:
    """What the application answers from.

    Attributes
    ----------
    execute
        Carries commands out; called on the web server's own loop.
    feed
        Committed events, on the same loop.
    access
        Who may what.
    peers
        Where refusals are logged.
    closing
        Set when the server ends: answers that do not end by themselves end then.
    streams
        Event streams that are being sent.
    """

    execute: Execute
    feed: EventFeed
    access: WebAccess
    peers: PeerLog
    closing: asyncio.Event = field(default_factory=asyncio.Event)
    streams: int = 0
