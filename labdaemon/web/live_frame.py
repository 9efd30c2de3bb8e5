"""The last capture's frames with their vectors, as small JPEGs: ``/live/frame/CAMERA.jpg``.

A RAW file takes a second of a processor, so a process of its own draws it, one at a time, at low priority, and only
while a page looks. Where it may read comes from the journal and from the daemon, never from the request.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from labdaemon.child_program import run_module
from labdaemon.processing import RESULTS
from labdaemon.stream.command_call import call_command, last_of_kind
from labdaemon.web.web_context import WebContext

LONGEST_S = 60.0
"""A drawing that takes longer is given up: the card or the network drive does not answer."""
NICENESS = 15
MOST_KEPT = 8
"""Drawings in memory, 50 kB each: several pages may look at the same frame."""


def live_frame_route(context: WebContext) -> Route:
    """The route; its drawings are shared by all clients."""
    drawings = _FrameDrawings()

    async def answer(request: Request) -> Response:
        camera = request.path_params["camera"]
        latest = await call_command(context.execute, "events.latest", {}, request.state.role)
        status = await call_command(context.execute, "status", {}, request.state.role)
        events = latest.result.get("events", []) if latest.error is None else []
        completed, data = last_of_kind(events, "capture.completed"), (status.result or {}).get("data")
        frames = {one["camera"]: one["path"] for one in completed["data"].get("frames") or ()} if completed else {}
        if completed is None or camera not in frames or not data:
            raise HTTPException(404, "there is no frame of this camera yet")
        name = completed["data"].get("group") or completed["data"]["capture"]
        envelope = last_of_kind(events, "envelope")
        is_measured = envelope is not None and envelope["data"].get("capture") == name
        file = Path(data) / frames[camera]
        campaign = Path(data, *Path(frames[camera]).parts[:2])
        words = [str(file), camera, name, str(campaign / RESULTS) if is_measured else ""]
        image = await drawings.get(tuple(words))
        return Response(image, media_type="image/jpeg", headers={"cache-control": "no-cache"})

    return Route("/live/frame/{camera}.jpg", answer)


class _FrameDrawings:
    """Draws in a child process, one at a time, and keeps the last drawings."""

    def __init__(self) -> None:
        self._kept: dict[tuple[str, ...], bytes] = {}
        self._turn = asyncio.Lock()

    async def get(self, words: tuple[str, ...]) -> bytes:
        """JPEG of a frame.

        Raises
        ------
        HTTPException
            It cannot be drawn; the detail says why.
        """
        async with self._turn:
            if words not in self._kept:
                self._kept[words] = await _draw(words)
                while len(self._kept) > MOST_KEPT:
                    self._kept.pop(next(iter(self._kept)))
            return self._kept[words]


async def _draw(words: tuple[str, ...]) -> bytes:
    try:
        result = await run_module("labdaemon.report.frame_view", *words, longest_s=LONGEST_S, niceness=NICENESS)
    except TimeoutError:
        raise HTTPException(503, f"the frame could not be drawn within {LONGEST_S:.0f} s") from None
    if result.status:
        raise HTTPException(503, f"the frame cannot be drawn: {result.complaint}")
    return result.output
