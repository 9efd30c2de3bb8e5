"""What each command does: parameters checked, the engine asked, and a JSON-able answer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from labdaemon.campaign.engine import Engine
from labdaemon.campaign.steps import Plan
from labdaemon.capture.places import campaign_folder
from labdaemon.errors import UsageError
from labdaemon.stream.commands import Handler
from labdaemon.stream.events import replay
from labdaemon.stream.messages import InvalidParams

MAX_LABEL = 200


def text_of(params: dict[str, Any], name: str, *, default: str | None = None, longest: int = 1 << 20) -> str:
    """A text parameter.

    Raises
    ------
    InvalidParams
        It is missing, or no text.
    """
    value = params.get(name, default)
    if not isinstance(value, str) or len(value) > longest:
        raise InvalidParams(f"{name} is a text of at most {longest} characters")
    return value


def handlers(
    engine: Engine, planner: Callable[[str], Plan], status: Callable[[], dict[str, Any]], rig: dict[str, Any]
) -> dict[str, Handler]:
    """Every command's handler by its name."""
    journal = engine.lab.recorder.journal

    async def tell_status(params: dict[str, Any]) -> Any:
        return {**status(), "seq": journal.last_seq, "journal": journal.uuid}

    async def tell_rig(params: dict[str, Any]) -> Any:
        return rig

    async def submit(params: dict[str, Any]) -> Any:
        plan = await asyncio.to_thread(planner, text_of(params, "toml"))
        id = await engine.submit(plan, params.get("request_id"))
        return {"campaign": id, "folder": str(campaign_folder(engine.lab.data, id))}

    async def pause(params: dict[str, Any]) -> Any:
        return {"campaign": await engine.pause(_campaign(params))}

    async def resume(params: dict[str, Any]) -> Any:
        accept = bool(params.get("accept_changed_rig", False))
        return {"campaign": await engine.resume(_campaign(params), accept_changed_rig=accept)}

    async def abort(params: dict[str, Any]) -> Any:
        return {"campaign": await engine.abort(_campaign(params))}

    async def capture(params: dict[str, Any]) -> Any:
        label = text_of(params, "label", default="", longest=MAX_LABEL)
        taken = await engine.capture(
            label, is_sharp=bool(params.get("sharp", False)), request_id=params.get("request_id")
        )
        return {"capture": taken.name, "opened_at": taken.opened_at}

    async def stop(params: dict[str, Any]) -> Any:
        rest = await engine.stop()
        return {"rest": rest.by, "troubles": list(rest.troubles)}

    async def replay_events(params: dict[str, Any]) -> Any:
        return replay(journal, params)

    return {
        "status": tell_status,
        "rig": tell_rig,
        "campaign.submit": submit,
        "campaign.pause": pause,
        "campaign.resume": resume,
        "campaign.abort": abort,
        "capture": capture,
        "events.replay": replay_events,
        "stop": stop,
    }


def _campaign(params: dict[str, Any]) -> str | None:
    value = params.get("campaign")
    if value is not None and not isinstance(value, str):
        raise UsageError("campaign is a campaign's id")
    return value
