"""Before a release and after it: nothing old is left to come, and each camera's own file of the opening is found.

A file that belongs to an earlier opening, of before a restart too, is set aside under that capture. Where neither time
nor order says whose a file is, none is believed and the capture is repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

from labdaemon.capture.collect import is_known, store, wait_frame
from labdaemon.capture.devices import Camera, CardFile
from labdaemon.capture.gather import gather_or_cancel, gather_to_completion
from labdaemon.capture.inspect_file import inspect
from labdaemon.capture.pairing import SD_S, CameraClocks, FileOrigin, Opening
from labdaemon.capture.paths import set_aside_path
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.rig import CALL_S, DeviceHandle, Rig
from labdaemon.clock import Clock, parse_rfc3339, rfc3339
from labdaemon.errors import DeviceError, TransportError
from labdaemon.imaging.raw_content import Kind
from labdaemon.journal import card_records
from labdaemon.journal.card_records import ClockOffset, OwedFile

LIST_S = 60.0
"""A card with thousands of foreign files takes a while to list."""

NEXT_FILE_S = 5.0
"""How long after a file that is of no opening the camera's own may still come."""

WRITTEN_OFF = 10.0
"""A file that is late by so many timeouts will not come any more."""


@dataclass(slots=True)
class FrameContext:
    """What frames are collected with.

    Attributes
    ----------
    data
        The data folder.
    timeout_s
        A file that has not come this long after twice the exposure is late: noise reduction doubles the time.
    others
        Files on cards that are no frames, by camera: looked into once.
    """

    rig: Rig
    recorder: Recorder
    clock: Clock
    data: Path
    clocks: CameraClocks
    timeout_s: Callable[[], float]
    others: dict[str, set[CardFile]] = field(default_factory=dict)

    def opening(self, owed: OwedFile) -> Opening:
        """An opening of the journal on the monotonic clock."""
        passed_s = (self.clock.now() - parse_rfc3339(owed.opened_at)).total_seconds()
        return Opening(owed.campaign, owed.capture, self.clock.monotonic() - passed_s, owed.exposure_s)

    def owed(self, camera: str) -> list[Opening]:
        """Openings for which this camera has not delivered, oldest first."""
        return [self.opening(owed) for owed in card_records.owed_files(self.recorder.journal, camera)]

    def late_s(self, opening: Opening) -> float:
        """When, on the monotonic clock, a file of this opening is late."""
        return opening.opened_s + 2.0 * opening.exposure_s + self.timeout_s()


def load_clocks(context: FrameContext) -> None:
    """Take the cameras' clock offsets from the journal, after a restart."""
    since = context.clock.now() - timedelta(seconds=context.clock.monotonic())
    for camera, known in card_records.clock_offsets(context.recorder.journal).items():
        measured_s = (parse_rfc3339(known.measured_at) - since).total_seconds()
        context.clocks.load(camera, known.offset_s + since.timestamp(), known.exposure_s, measured_s)


def clock_offsets(context: FrameContext, opening: Opening, cameras: Mapping[str, CardFile]) -> list[ClockOffset]:
    """What the journal keeps of the clocks after an opening."""
    since = context.clock.now() - timedelta(seconds=context.clock.monotonic())
    measured_at = rfc3339(since + timedelta(seconds=opening.opened_s))
    return [
        ClockOffset(camera, offset_s - since.timestamp(), SD_S, opening.exposure_s, measured_at)
        for camera in cameras
        if (offset_s := context.clocks.offset_s(camera)) is not None
    ]


async def prepare_cameras(context: FrameContext) -> dict[str, frozenset[int]]:
    """Before a release: wait for files that may be taken for its own, set aside what is there.

    Returns
    -------
    Handles on each card now: what is behind them is no file of the opening to come.
    """
    cameras = context.rig.cameras
    handles = await gather_to_completion(_prepare(context, name, camera) for name, camera in cameras.items())
    return dict(zip(cameras, handles, strict=True))


async def _prepare(context: FrameContext, name: str, camera: DeviceHandle[Camera]) -> frozenset[int]:
    while True:
        slice_s = 1.0 if await _is_file_due(context, name) else 0.0
        file = await wait_frame(camera, context.recorder, context.clock, slice_s)
        if file is not None:
            await set_aside(context, name, file)
        elif not slice_s:
            break
    on_card = await camera.call(lambda driver: driver.files(), LIST_S + CALL_S)
    for file in await unaccounted_files(context, name, on_card):
        await set_aside(context, name, file)
    return frozenset(file.handle for file in on_card)


async def _is_file_due(context: FrameContext, camera: str) -> bool:
    """Whether a file is due that a file of an opening now would resemble; those that will not come are dropped."""
    now_s = context.clock.monotonic()
    rows = card_records.owed_files(context.recorder.journal, camera)
    dropped = [
        owed
        for owed in rows
        if now_s > context.late_s(context.opening(owed)) + WRITTEN_OFF * context.timeout_s()
        or now_s < context.opening(owed).opened_s - 1.0  # the wall clock was set back: it says nothing any more
    ]
    if dropped:
        await context.recorder.write(card_records.forget_owed, camera, dropped)
    return any(
        now_s < context.late_s(opening) and not context.clocks.can_distinguish(camera, opening, now_s)
        for opening in (context.opening(owed) for owed in rows if owed not in dropped)
    )


async def unaccounted_files(context: FrameContext, camera: str, on_card: list[CardFile]) -> list[CardFile]:
    """RAW files, written to their end, that the journal does not account for."""
    known = card_records.card_files(context.recorder.journal, camera)
    others = context.others.setdefault(camera, set())
    others.intersection_update(on_card)
    found: list[CardFile] = []
    for file in on_card:
        exact = card_records.CardIdentity(file.name, file.captured_at, file.handle, file.size_bytes)
        if exact in known or file in others or is_known(context.recorder, camera, file):
            continue
        kind, now = await inspect(context.rig.cameras[camera], file)
        if kind is Kind.RAW:
            found.append(now)
        elif kind is Kind.OTHER:
            others.add(file)
    return found


async def set_aside(context: FrameContext, camera: str, file: CardFile) -> None:
    """Fetch a file that no capture expects, under the capture that it is owed for if there is one."""
    owner = context.clocks.owner(camera, file, context.owed(camera))
    campaign, capture = (owner.campaign, owner.capture) if owner is not None else ("", "")
    await store(
        context.rig.cameras[camera],
        file,
        set_aside_path(context.data, campaign, capture, camera, file.name),
        context.recorder,
        context.clock,
        campaign=campaign,
        capture=capture,
        state="set_aside",
    )


async def wait_frames(
    context: FrameContext, opening: Opening, seen: Mapping[str, frozenset[int]], *, is_external: bool = False
) -> dict[str, CardFile]:
    """Each camera's own file of this opening.

    Parameters
    ----------
    seen
        Handles that were on the cards before the release.
    is_external
        Others release the shutters.

    Raises
    ------
    TransportError
        A camera delivered none in time: it is lost, out of power, or was not released.
    DeviceError
        What it delivered is of another opening, or may be.
    """
    cameras = context.rig.cameras
    files = await gather_or_cancel(
        _wait_frame(context, name, opening, seen.get(name, frozenset()), is_external) for name in cameras
    )
    return dict(zip(cameras, files, strict=True))


async def wait_external_frames(context: FrameContext, opened_at: datetime, exposure_s: float) -> dict[str, CardFile]:
    """Each camera's own file of a release that an outside system caused; the cameras' clocks are learned from them.

    Parameters
    ----------
    opened_at
        Wall-clock time of the opening, as the trigger device saw it.
    exposure_s
        The longest that a body is set to; 0 where that is unknown.

    Raises
    ------
    TransportError, DeviceError
        As `wait_frames`: a body that missed the release must not lend it the next one's file.
    """
    passed_s = (context.clock.now() - opened_at).total_seconds()
    opening = Opening("", "", context.clock.monotonic() - passed_s, exposure_s)
    files = await wait_frames(context, opening, {}, is_external=True)
    context.clocks.update(files, opening)
    return files


async def _wait_frame(
    context: FrameContext, camera: str, opening: Opening, seen: frozenset[int], is_external: bool
) -> CardFile:
    clock, clocks = context.clock, context.clocks
    owed = [
        other
        for other in context.owed(camera)
        if other.capture != opening.capture or other.campaign != opening.campaign
    ]
    closed_s = opening.opened_s + opening.exposure_s
    end_s = context.late_s(opening)
    unfinished: list[CardFile] = []
    held: list[CardFile] = []
    foreign: CardFile | None = None
    while True:
        left_s = max(end_s - clock.monotonic(), 0.0)
        file = await wait_frame(context.rig.cameras[camera], context.recorder, clock, left_s, unfinished)
        if file is None:
            break
        now_s = clock.monotonic()
        verdict = FileOrigin.EARLIER
        if file.handle not in seen:
            verdict = clocks.judge(camera, file, opening, owed, is_external=is_external)
        if verdict is FileOrigin.OWN:
            return file
        if verdict is FileOrigin.EARLIER:
            owner = clocks.owner(camera, file, owed)
            owed = [other for other in owed if other is not owner]
        elif verdict is FileOrigin.FOREIGN:
            foreign = file
            end_s = min(end_s, max(now_s, closed_s) + NEXT_FILE_S)
        else:
            held.append(file)
            lateness_s = now_s - owed[0].opened_s - owed[0].exposure_s if owed else 0.0
            # If it is the earlier opening's, the own one may be as late again.
            end_s = max(end_s, closed_s + 2.0 * lateness_s)
        if held and len(held) > len(owed):
            return held[-1]  # as many as were owed came before it
    if held:
        await context.recorder.write(
            card_records.forget_owed, camera, card_records.owed_files(context.recorder.journal, camera)
        )
        raise DeviceError(
            f"{held[0].name} may be of this opening or of an earlier one, whose file never came; "
            "neither is believed, the capture is repeated",
            device=camera,
        )
    if foreign is not None:
        raise DeviceError(
            f"{foreign.name} was taken {clocks.deviation_s(camera, foreign, opening):+.1f} s away from this opening "
            "and belongs to another one; the capture is repeated",
            device=camera,
        )
    waited_s = clock.monotonic() - opening.opened_s
    why = f"{unfinished[0].name} is not written to its end" if unfinished else "no frame"
    raise TransportError(
        f"{why} within {waited_s:.3g} s of the release; check cable, power, shutter lead and that it takes RAW",
        device=camera,
    )
