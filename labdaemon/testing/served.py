"""A daemon's commands and events in memory, for servers of other protocols."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from labdaemon.journal.event import EventText
from labdaemon.stream import messages
from labdaemon.stream.messages import RpcRequest
from labdaemon.stream.roles import Role, check_role

TARGETS: list[dict[str, Any]] = [
    {"target": "P1", "capture": "manual-000001", "x_mm": 1.0, "ax_mm": 0.5, "ay_mm": 0.0, "az_mm": 0.0, "bx_mm": 0.0}
    | {"by_mm": -0.25, "bz_mm": None, "flags": ["at_rest", "occluded"]},
    {"target": 'P"2', "flags": []},
]
"""Of an envelope: one target that was measured, one that was not."""


def event_document(seq: int, kind: str, **data: Any) -> dict[str, Any]:
    """An event as it travels."""
    head = {"v": 1, "seq": seq, "at": "2026-01-01T00:00:00Z", "kind": kind, "campaign": None, "journal": "j"}
    return head | {"data": data}


class FakeOutbox:
    """A journal in memory."""

    uuid = "j"

    def __init__(self) -> None:
        self.events: list[EventText] = []
        self.cut_before: int = 1

    @property
    def last_seq(self) -> int:
        return len(self.events)

    def add(self, kind: str, **data: Any) -> None:
        seq = len(self.events) + 1
        self.events.append(EventText(seq, kind, json.dumps(event_document(seq, kind, **data)).encode()))

    def recent(self, seq: int, limit: int, most_bytes: int) -> list[EventText]:
        seq = max(seq, self.cut_before - 1)
        return self.events[seq : seq + limit]

    history = recent

    def latest(self) -> list[EventText]:
        return list({one.kind: one for one in self.events}.values())


class FakeDaemon:
    """Answers commands, and notes what was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any], Role]] = []
        self.errors: dict[str, tuple[int, str]] = {}
        self.hold: asyncio.Event = asyncio.Event()
        self.hold.set()
        self.outbox: FakeOutbox = FakeOutbox()
        self.shots: int = 0
        self.data: str | None = None

    def methods(self) -> list[str]:
        return [method for method, _, _ in self.asked]

    async def execute(self, request: RpcRequest, role: Role) -> bytes:
        self.asked.append((request.method, request.params, role))
        try:
            check_role(request.method, role)
        except messages.ForbiddenError as exc:
            return messages.error_bytes(messages.FORBIDDEN, str(exc), request.id)
        if request.method in self.errors:
            code, text = self.errors[request.method]
            return messages.error_bytes(code, text, request.id)
        result: Any = {}
        match request.method:
            case "capture":
                await self.hold.wait()
                self.shots += 1
                result = {"capture": f"manual-{self.shots:06d}", "opened_at": "2026-05-04T10:11:12.123456Z"}
            case "status":
                result = {
                    "state": "idle",
                    "table": "rest",
                    "campaign": None,
                    "captures_manual": self.shots,
                    "faults": 0,
                    "data": self.data,
                }
            case "stop":
                result = {"rest": "soft", "table": "rest", "troubles": []}
            case "events.latest":
                result = {"events": [json.loads(one.json) for one in self.outbox.latest()]}
                result |= {"last": self.outbox.last_seq, "journal": self.outbox.uuid}
        return messages.result_bytes(result, request.id)
