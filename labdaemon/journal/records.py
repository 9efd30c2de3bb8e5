"""Rows of the journal as values, and the states they go through.

A campaign is ``queued`` → ``running`` ⇄ ``paused`` → ``completed`` | ``aborted`` | ``failed``; a step ``running`` →
``completed`` | ``skipped``.

A capture is ``intended`` (about to fire) → ``fired`` (shutters opened) → ``exposed`` (they have closed, and the table
was still at its excitation: from here on the frames are worth keeping) → ``stored`` (every camera's frame is synced,
its size and hash known) → ``measured``, or ``unmeasured`` when measuring failed for good. One that was interrupted
before ``exposed`` is ``discarded`` and repeated under another name; its frames are set aside, never lost.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, Literal

from labdaemon.journal.card_records import CardIdentity
from labdaemon.journal.journal import Journal

CampaignState = Literal["queued", "running", "paused", "completed", "aborted", "failed"]
CaptureState = Literal["intended", "fired", "exposed", "stored", "measured", "unmeasured", "discarded"]
FrameState = Literal["stored", "set_aside"]

RESULTS_AT_A_TIME = 20  # of 500 targets each: a few megabytes, whatever the campaign's length

NO_STEP = -1
"""`CaptureRecord.step` of captures that belong to no step: a person's, and an outside system's while none runs."""


UNKNOWN_EXPOSURE_S = 0.0
"""`CaptureRecord.exposure_s` where others released and neither they nor the frame says how long it was exposed."""


@dataclass(frozen=True, slots=True)
class CampaignRecord:
    """A campaign as submitted, and how far it is."""

    id: str
    number: int
    name: str
    toml: str
    digest: str
    state: CampaignState
    reason: str | None
    submitted_at: str


@dataclass(frozen=True, slots=True)
class StepRecord:
    """A step that has been started at least once."""

    campaign: str
    step: int
    state: Literal["running", "completed", "skipped"]
    attempts: int
    reason: str | None


@dataclass(frozen=True, slots=True)
class CaptureRecord:
    """A capture: what it was meant to be, and what is known of its opening.

    Attributes
    ----------
    shot
        Its place among the step's shots.
    label
        The step's label, or what a person called a manual capture.
    sharp
        The sharp set it is measured against; None for the flat set, or when it is itself sharp.
    grouped
        Name under which it is measured jointly with others, None when on its own.
    opening_s
        Opening time of each camera after the release, where measured, seconds.
    cameras
        Names of the cameras that owe a frame.
    files
        What each camera's file is known by on its card; known from ``exposed`` on.
    """

    campaign: str
    name: str
    step: int
    shot: int
    label: str
    is_sharp: bool
    sharp: str | None
    grouped: str | None
    state: CaptureState
    frequency_hz: float | None
    amplitude_mm: float | None
    exposure_s: float
    opened_at: str | None
    opening_s: dict[str, float]
    phase_rad: float | None
    sd_phase_rad: float | None
    cameras: tuple[str, ...]
    files: dict[str, CardIdentity]
    reason: str | None


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame on disk. `path` is relative to the data folder; `card_name` and `captured_at` are the camera's own."""

    campaign: str
    capture: str
    camera: str
    path: str
    card_name: str
    captured_at: str
    size_bytes: int
    sha256: str
    state: FrameState


@dataclass(frozen=True, slots=True)
class ResultRecord:
    """An envelope's rows and the measurements behind it, as the result files carry them."""

    campaign: str
    name: str
    envelope: list[dict[str, Any]]
    measurements: list[dict[str, Any]]


_CAMPAIGN = ", ".join(field.name for field in fields(CampaignRecord))
_FRAME = ", ".join(field.name for field in fields(FrameRecord))
_CAPTURE = ", ".join("opening" if field.name == "opening_s" else field.name for field in fields(CaptureRecord))


def campaigns(journal: Journal, *states: CampaignState, limit: int = -1) -> list[CampaignRecord]:
    """Campaigns in these states (any, if none is given), in the order of submission; at most `limit`, -1 for all."""
    marks = ",".join("?" * len(states))
    where = f"WHERE state IN ({marks})" if states else ""
    sql = f"SELECT {_CAMPAIGN} FROM campaigns {where} ORDER BY number LIMIT ?"
    return [CampaignRecord(*row) for row in journal.read(sql, *states, limit)]


def campaign(journal: Journal, id: str) -> CampaignRecord | None:
    """One campaign, None if there is none of this id."""
    rows = journal.read(f"SELECT {_CAMPAIGN} FROM campaigns WHERE id = ?", id)
    return CampaignRecord(*rows[0]) if rows else None


def steps(journal: Journal, campaign: str) -> dict[int, StepRecord]:
    """A campaign's started steps by index."""
    rows = journal.read("SELECT campaign, step, state, attempts, reason FROM steps WHERE campaign = ?", campaign)
    return {row[1]: StepRecord(*row) for row in rows}


def step(journal: Journal, campaign: str, index: int) -> StepRecord | None:
    """One step, None if it was never started."""
    rows = journal.read(
        "SELECT campaign, step, state, attempts, reason FROM steps WHERE campaign = ? AND step = ?", campaign, index
    )
    return StepRecord(*rows[0]) if rows else None


def captures(
    journal: Journal, campaign: str | None = None, *states: CaptureState, step: int | None = None
) -> list[CaptureRecord]:
    """Captures of a campaign (or of all) in these states (or in any), by name."""
    conditions: list[str] = []
    values: list[str | int] = []
    if campaign is not None:
        conditions.append("campaign = ?")
        values.append(campaign)
    if step is not None:
        conditions.append("step = ?")
        values.append(step)
    if states:
        conditions.append(f"state IN ({','.join('?' * len(states))})")
        values.extend(states)
    where = f"WHERE {' AND '.join(conditions)}" if conditions else ""
    rows = journal.read(f"SELECT {_CAPTURE} FROM captures {where} ORDER BY campaign, name", *values)
    return [_capture(row) for row in rows]


def manual_count(journal: Journal, campaign: str) -> int:
    """How many captures of a campaign were begun that belong to no step."""
    rows = journal.read("SELECT count(*) FROM captures WHERE campaign = ? AND step = ?", campaign, NO_STEP)
    return int(rows[0][0])


def has_capture(journal: Journal, campaign: str, name: str) -> bool:
    """Whether a name is taken by a capture, or by the group of one."""
    return bool(
        journal.read(
            "SELECT 1 FROM captures WHERE campaign = ? AND (name = ? OR grouped = ?) LIMIT 1", campaign, name, name
        )
    )


def is_taken(journal: Journal, campaign: str, group: str) -> bool:
    """Whether a group's name is a capture's, or that of a planned group."""
    return bool(
        journal.read(
            "SELECT 1 FROM captures WHERE campaign = ? AND (name = ? OR (grouped = ? AND step != ?)) LIMIT 1",
            campaign,
            group,
            group,
            NO_STEP,
        )
    )


def latest_sharp(journal: Journal, campaign: str) -> CaptureRecord | None:
    """The newest sharp frame that is stored; its `sharp` names the set. None if there is none."""
    rows = journal.read(
        f"SELECT {_CAPTURE} FROM captures WHERE campaign = ? AND is_sharp = 1 AND state = 'stored' "
        "ORDER BY opened_at DESC LIMIT 1",
        campaign,
    )
    return _capture(rows[0]) if rows else None


def group_members(journal: Journal, campaign: str, group: str) -> list[CaptureRecord]:
    """Stored captures of a manual group, measured or not, by name."""
    rows = journal.read(
        f"SELECT {_CAPTURE} FROM captures WHERE campaign = ? AND step = ? AND grouped = ? "
        "AND state IN ('stored', 'measured') ORDER BY name",
        campaign,
        NO_STEP,
        group,
    )
    return [_capture(row) for row in rows]


def frames(journal: Journal, campaign: str, capture: str) -> list[FrameRecord]:
    """Frames of a capture, in the order in which they were stored."""
    rows = journal.read(
        f"SELECT {_FRAME} FROM frames WHERE campaign = ? AND capture = ? ORDER BY id", campaign, capture
    )
    return [FrameRecord(*row) for row in rows]


def frame_of_card(journal: Journal, camera: str, file: CardIdentity) -> FrameRecord | None:
    """The frame that a file on a camera's card was copied to last, by name, time and size; None if there is none."""
    rows = journal.read(
        f"SELECT {_FRAME} FROM frames WHERE camera = ? AND card_name = ? AND captured_at = ? AND size_bytes = ? "
        "ORDER BY id DESC LIMIT 1",
        camera,
        file.name,
        file.captured_at,
        file.size_bytes,
    )
    return FrameRecord(*rows[0]) if rows else None


def results(journal: Journal, campaign: str) -> Iterator[ResultRecord]:
    """A campaign's results in the order in which they were measured, a few at a time in memory."""
    number = 0
    while rows := journal.read(
        "SELECT campaign, name, envelope, measurements, number FROM results WHERE campaign = ? AND number > ? "
        "ORDER BY number LIMIT ?",
        campaign,
        number,
        RESULTS_AT_A_TIME,
    ):
        for row in rows:
            yield ResultRecord(row[0], row[1], json.loads(row[2]), json.loads(row[3]))
        number = rows[-1][4]


def envelope_rows(journal: Journal, campaign: str, name: str) -> list[dict[str, Any]]:
    """The rows of one envelope, as `envelope.csv` carries them; empty where there is none of this name."""
    found = journal.read("SELECT envelope FROM results WHERE campaign = ? AND name = ?", campaign, name)
    rows: list[dict[str, Any]] = json.loads(found[0][0]) if found else []
    return rows


def result_names(journal: Journal, campaign: str) -> set[str]:
    """Captures and groups of a campaign that have a result."""
    return {row[0] for row in journal.read("SELECT name FROM results WHERE campaign = ?", campaign)}


def stamp_of(journal: Journal, campaign: str) -> str | None:
    """What a campaign's result files were like when it ended, see `labdaemon.journal.transitions.keep_stamp`."""
    rows = journal.read("SELECT value FROM meta WHERE key = ?", f"results:{campaign}")
    return str(rows[0][0]) if rows else None


def count_shots(journal: Journal, campaign: str, step: int, shot: int) -> int:
    """How often a step's shot was begun, whatever became of it."""
    sql = "SELECT count(*) FROM captures WHERE campaign = ? AND step = ? AND shot = ?"
    return int(journal.read(sql, campaign, step, shot)[0][0])


def count_campaigns(journal: Journal, state: CampaignState) -> int:
    """How many campaigns are in this state."""
    return int(journal.read("SELECT count(*) FROM campaigns WHERE state = ?", state)[0][0])


def captures_by_step(journal: Journal, campaign: str) -> dict[int, int]:
    """How many captures of each step are stored, measured or not; manual ones are those of step `NO_STEP`."""
    rows = journal.read(
        "SELECT step, count(*) FROM captures WHERE campaign = ? AND state IN ('stored', 'measured', 'unmeasured') "
        "GROUP BY step",
        campaign,
    )
    return {int(step): int(count) for step, count in rows}


def reply_to(journal: Journal, request_id: str) -> tuple[str, dict[str, Any]] | None:
    """Method and reply of a request that was already carried out."""
    rows = journal.read("SELECT method, reply FROM requests WHERE request_id = ?", request_id)
    return (rows[0][0], json.loads(rows[0][1])) if rows else None


def _capture(row: tuple[Any, ...]) -> CaptureRecord:
    values = dict(zip((field.name for field in fields(CaptureRecord)), row, strict=True))
    values["is_sharp"] = bool(values["is_sharp"])
    values["opening_s"] = json.loads(values["opening_s"])
    values["files"] = {camera: CardIdentity(*known) for camera, known in json.loads(values["files"]).items()}
    values["cameras"] = tuple(json.loads(values["cameras"]))
    return CaptureRecord(**values)
