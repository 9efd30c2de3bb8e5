"""What each command does: parameters checked, the engine asked, and a JSON-able answer."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from labdaemon.campaign.engine import Engine
from labdaemon.campaign.steps import Plan
from labdaemon.capture.paths import campaign_folder
from labdaemon.capture.table_evidence import describe
from labdaemon.off_loop import off_loop
from labdaemon.service.campaign_queries import MOST_LISTED, CampaignQueries
from labdaemon.service.capture_parameters import capture_request
from labdaemon.service.command_parameters import CommandParameters
from labdaemon.service.openrpc import openrpc_document
from labdaemon.stream.dispatcher import Handler
from labdaemon.stream.publisher import latest, replay
from labdaemon.tomlfile import MAX_BYTES

MOST_PLACES = 1_000_000
MAX_ID = 200
"""Characters of a campaign's or request's id."""


def handlers(
    engine: Engine,
    planner: Callable[[str], Plan],
    status: Callable[[], dict[str, Any]],
    rig: dict[str, Any],
    *,
    aside: Callable[..., Awaitable[Any]] = off_loop,
) -> dict[str, Handler]:
    """Every command's handler by its name.

    Parameters
    ----------
    aside
        Calls what blocks (a plan, a long read of the journal) off the event loop; simulated time calls it at once.
    """
    journal = engine.context.recorder.journal

    async def answer_status(params: dict[str, Any]) -> Any:
        CommandParameters(params)
        return {**status(), "seq": journal.last_seq, "journal": journal.uuid}

    async def answer_rig(params: dict[str, Any]) -> Any:
        CommandParameters(params)
        return rig

    async def submit(params: dict[str, Any]) -> Any:
        given = CommandParameters(params, "toml", "request_id")
        request_id = given.optional_text("request_id", longest=MAX_ID)
        plan = await aside(planner, given.text("toml", longest=MAX_BYTES))
        id = await engine.submit(plan, request_id)
        notes = {"notes": list(plan.notes)} if plan.notes else {}
        return {"campaign": id, "folder": str(campaign_folder(engine.context.data, id)), **notes}

    async def pause(params: dict[str, Any]) -> Any:
        return {"campaign": await engine.pause(_campaign(CommandParameters(params, "campaign")))}

    async def resume(params: dict[str, Any]) -> Any:
        given = CommandParameters(params, "campaign", "accept_changed_rig")
        accept = given.flag("accept_changed_rig")
        return {"campaign": await engine.resume(_campaign(given), accept_changed_rig=accept)}

    async def abort(params: dict[str, Any]) -> Any:
        return {"campaign": await engine.abort(_campaign(CommandParameters(params, "campaign")))}

    queries = CampaignQueries(engine)

    async def list_campaigns(params: dict[str, Any]) -> Any:
        limit = CommandParameters(params, "limit").whole("limit", least=1, most=MOST_LISTED, default=100)
        return await aside(queries.list, limit)

    async def show(params: dict[str, Any]) -> Any:
        return await aside(queries.show, _campaign(CommandParameters(params, "campaign")))

    async def move(params: dict[str, Any]) -> Any:
        given = CommandParameters(params, "campaign", "place")
        place = given.whole("place", least=0, most=MOST_PLACES, default=0)
        return await queries.move(given.text("campaign", longest=MAX_ID), place)

    async def capture(params: dict[str, Any]) -> Any:
        taken = await engine.capture(capture_request(params))
        return {"capture": taken.name, "opened_at": taken.opened_at}

    async def stop(params: dict[str, Any]) -> Any:
        # Parameters of any name are let through: nothing may keep the table from being stopped.
        rest = await engine.stop()
        table = engine.context.table.state
        seen = describe(rest.seen) if table is not None else None
        return {"rest": rest.by, "table": table, "seen": seen, "troubles": list(rest.troubles)}

    async def replay_events(params: dict[str, Any]) -> Any:
        CommandParameters(params, "after", "limit")
        return await aside(replay, journal, params)

    async def latest_events(params: dict[str, Any]) -> Any:
        CommandParameters(params)
        return await aside(latest, journal, params)

    async def discover(params: dict[str, Any]) -> Any:
        CommandParameters(params)
        return await aside(openrpc_document)

    return {
        "status": answer_status,
        "rig": answer_rig,
        "campaign.submit": submit,
        "campaign.pause": pause,
        "campaign.resume": resume,
        "campaign.abort": abort,
        "campaign.list": list_campaigns,
        "campaign.show": show,
        "campaign.move": move,
        "capture": capture,
        "events.replay": replay_events,
        "events.latest": latest_events,
        "rpc.discover": discover,
        "stop": stop,
    }


def _campaign(given: CommandParameters) -> str | None:
    """The campaign that a command is about; None for the current one."""
    return given.optional_text("campaign", longest=MAX_ID)
