"""Every change of state, each in one transaction with the event that reports it.

The transitions' names (first argument of `Journal.transaction`) are what crash tests kill the daemon at.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from labdaemon.events import (
    CampaignData,
    CaptureData,
    DecisionData,
    EnvelopeData,
    EventPart,
    FaultData,
    GaugeMotion,
    StepData,
    check_payload,
)
from labdaemon.journal.card_records import CardIdentity, ClockOffset, add_card_file, keep_offsets
from labdaemon.journal.decision_records import keep_decision
from labdaemon.journal.gauge_records import keep_gauges
from labdaemon.journal.journal import Journal, Transaction
from labdaemon.journal.light_record import LightRecord, keep_light
from labdaemon.journal.records import CampaignState, CaptureRecord, FrameRecord, reply_to

MANUAL = "0000-manual"
"""Captures that a person or an outside system takes while no campaign runs."""

NOTHING_MORE = CampaignData()
"""A campaign's change of state that needs no more than its name."""

CAMPAIGN_EVENTS: dict[CampaignState, str] = {
    "running": "campaign.started",
    "paused": "campaign.paused",
    "completed": "campaign.completed",
    "aborted": "campaign.aborted",
    "failed": "campaign.failed",
}


WAYS_TO: dict[CampaignState, tuple[CampaignState, ...]] = {
    "running": ("queued", "paused"),
    "paused": ("queued", "running"),
    "completed": ("running",),
    "aborted": ("queued", "running", "paused"),
    "failed": ("queued", "running", "paused"),
}
"""States from which a campaign may come to each."""


def submit(journal: Journal, name: str, toml: str, digest: str, request_id: str | None = None) -> str:
    """Queue a campaign and return its id; a `request_id` seen before answers the same and queues nothing."""
    with journal.transaction("campaign.queued") as write:
        if request_id is not None and (known := reply_to(journal, request_id)):
            return str(known[1].get("campaign"))
        number = write.execute("SELECT coalesce(max(number), 0) + 1 FROM campaigns").fetchone()[0]
        slug = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "campaign"
        id = f"{number:04d}-{slug[:60]}"
        write.execute(
            "INSERT INTO campaigns VALUES (?, ?, ?, ?, ?, 'queued', NULL, ?)", id, number, name, toml, digest, write.at
        )
        _answer(write, request_id, "campaign.submit", {"campaign": id})
    return id


def open_manual(journal: Journal) -> str:
    """The id under which captures outside any campaign are kept; made when first asked for, without an event."""
    with journal.transaction("campaign.manual") as write:
        write.execute(
            "INSERT OR IGNORE INTO campaigns VALUES (?, 0, 'manual', '', '', 'completed', NULL, ?)", MANUAL, write.at
        )
    return MANUAL


def move_campaign(
    journal: Journal,
    campaign: str,
    state: CampaignState,
    reason: str | None = None,
    data: CampaignData = NOTHING_MORE,
) -> bool:
    """Put a campaign into another state; running again is reported as ``campaign.resumed``.

    Returns
    -------
    bool
        False, and nothing changed, if it is in a state from which there is no way there: another request was faster.
    """
    kind = CAMPAIGN_EVENTS[state]
    with journal.transaction(kind) as write:
        before = write.execute("SELECT state FROM campaigns WHERE id = ?", campaign).fetchone()[0]
        if before not in WAYS_TO[state]:
            return False
        reported = write.execute("SELECT 1 FROM events WHERE campaign = ? AND kind = ?", campaign, kind).fetchone()
        if state == "running" and reported is not None:
            kind = "campaign.resumed"
        write.execute("UPDATE campaigns SET state = ?, reason = ? WHERE id = ?", state, reason, campaign)
        _emit(write, kind, campaign, data.model_copy(update={"reason": reason} if reason else {}))
    return True


def accept_digest(journal: Journal, campaign: str, digest: str) -> None:
    """Let a campaign go on under a changed rig, because a person said so."""
    with journal.transaction("campaign.digest") as write:
        write.execute("UPDATE campaigns SET digest = ? WHERE id = ?", digest, campaign)


def start_step(journal: Journal, campaign: str, data: StepData) -> int:
    """Begin a step, or begin it again; returns which attempt this is, from 1."""
    with journal.transaction("step.started") as write:
        known = "SELECT attempts FROM steps WHERE campaign = ? AND step = ?"
        row = write.execute(known, campaign, data.step).fetchone()
        attempt = 1 + (row[0] if row else 0)
        write.execute("INSERT OR REPLACE INTO steps VALUES (?, ?, 'running', ?, NULL)", campaign, data.step, attempt)
        _emit(write, "step.started", campaign, data.model_copy(update={"attempt": attempt}))
    return attempt


def end_step(journal: Journal, campaign: str, data: StepData, skipped: str | None = None) -> None:
    """Complete a step, or skip it for the given reason."""
    kind = "step.completed" if skipped is None else "step.skipped"
    with journal.transaction(kind) as write:
        state = kind.removeprefix("step.")
        write.execute(
            "INSERT INTO steps VALUES (?, ?, ?, 0, ?) "
            "ON CONFLICT DO UPDATE SET state = excluded.state, reason = excluded.reason",
            campaign,
            data.step,
            state,
            skipped,
        )
        _emit(write, kind, campaign, data.model_copy(update={"reason": skipped} if skipped is not None else {}))


def decide_step(journal: Journal, campaign: str, decision: DecisionData) -> None:
    """Note what a search for modes has decided of a step that the plan left open."""
    with journal.transaction("step.decided") as write:
        keep_decision(write, campaign, decision)
        _emit(write, "step.decided", campaign, decision)


def intend_capture(journal: Journal, capture: CaptureRecord) -> None:
    """Note a capture before it is fired, so that a frame found later on a card has something to belong to."""
    with journal.transaction("capture.intended") as write:
        write.execute(
            "INSERT INTO captures (campaign, name, step, shot, label, is_sharp, sharp, grouped, state, frequency_hz, "
            "amplitude_mm, exposure_s, cameras) VALUES (?, ?, ?, ?, ?, ?, ?, ?, 'intended', ?, ?, ?, ?)",
            capture.campaign,
            capture.name,
            capture.step,
            capture.shot,
            capture.label,
            int(capture.is_sharp),
            capture.sharp,
            capture.grouped,
            capture.frequency_hz,
            capture.amplitude_mm,
            capture.exposure_s,
            json.dumps(capture.cameras),
        )
        for camera in capture.cameras:
            write.execute(
                "INSERT OR REPLACE INTO owed_files (camera, campaign, capture, opened_at, exposure_s) "
                "VALUES (?, ?, ?, ?, ?)",
                camera,
                capture.campaign,
                capture.name,
                write.at,
                capture.exposure_s,
            )


def fire_capture(
    journal: Journal,
    campaign: str,
    name: str,
    *,
    opened_at: str,
    opening_s: Mapping[str, float],
    phase_rad: float | None,
    sd_phase_rad: float | None,
    request_id: str | None = None,
) -> None:
    """Note when and at which phase the shutters opened; answers the request that asked for it."""
    with journal.transaction("capture.fired") as write:
        write.execute(
            "UPDATE captures SET state = 'fired', opened_at = ?, opening = ?, phase_rad = ?, sd_phase_rad = ? "
            "WHERE campaign = ? AND name = ?",
            opened_at,
            json.dumps(dict(opening_s)),
            phase_rad,
            sd_phase_rad,
            campaign,
            name,
        )
        write.execute(
            "UPDATE owed_files SET opened_at = ? WHERE campaign = ? AND capture = ?", opened_at, campaign, name
        )
        _answer(write, request_id, "capture", {"capture": name, "opened_at": opened_at})


def light_capture(journal: Journal, campaign: str, name: str, light: LightRecord) -> None:
    """Note the light code that was played while the shutters were open."""
    with journal.transaction("capture.lit") as write:
        keep_light(write, campaign, name, light)


def describe_capture(journal: Journal, capture: CaptureRecord) -> None:
    """Note what was found out of a capture after it was fired: excitation, exposure, sharp set."""
    with journal.transaction("capture.described") as write:
        write.execute(
            "UPDATE captures SET frequency_hz = ?, amplitude_mm = ?, exposure_s = ?, sharp = ? "
            "WHERE campaign = ? AND name = ?",
            capture.frequency_hz,
            capture.amplitude_mm,
            capture.exposure_s,
            capture.sharp,
            capture.campaign,
            capture.name,
        )


def expose_capture(
    journal: Journal,
    campaign: str,
    name: str,
    files: Mapping[str, CardIdentity],
    offsets: Iterable[ClockOffset] = (),
    gauges: Iterable[GaugeMotion] = (),
) -> None:
    """The shutters have closed and the excitation had not changed: these files are worth keeping.

    `offsets` of the cameras' clocks were found from them; `gauges` saw the motion meanwhile.
    """
    with journal.transaction("capture.exposed") as write:
        write.execute(
            "UPDATE captures SET state = 'exposed', files = ? WHERE campaign = ? AND name = ?",
            json.dumps(dict(files)),
            campaign,
            name,
        )
        write.execute("DELETE FROM owed_files WHERE campaign = ? AND capture = ?", campaign, name)
        keep_offsets(write, offsets)
        keep_gauges(write, campaign, name, gauges)


def store_frame(journal: Journal, frame: FrameRecord, file: CardIdentity | None = None) -> None:
    """Vouch for a frame that is synced under its final name. After this, and not before, its card may be cleared.

    `file` is what it is known by on the card, where it is still there.
    """
    with journal.transaction("frame.stored") as write:
        write.execute(
            "INSERT OR REPLACE INTO frames (campaign, capture, camera, path, card_name, captured_at, size_bytes, "
            "sha256, state) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
            frame.campaign,
            frame.capture,
            frame.camera,
            frame.path,
            frame.card_name,
            frame.captured_at,
            frame.size_bytes,
            frame.sha256,
            frame.state,
        )
        if file is not None:
            add_card_file(write, frame.camera, file, is_copied=True)
        write.execute(
            "DELETE FROM owed_files WHERE camera = ? AND campaign = ? AND capture = ?",
            frame.camera,
            frame.campaign,
            frame.capture,
        )


def complete_capture(journal: Journal, campaign: str, data: CaptureData) -> None:
    """Every camera's frame is stored."""
    with journal.transaction("capture.completed") as write:
        write.execute("UPDATE captures SET state = 'stored' WHERE campaign = ? AND name = ?", campaign, data.capture)
        _emit(write, "capture.completed", campaign, data)


def discard_capture(journal: Journal, campaign: str, name: str, reason: str, moved: Mapping[str, str]) -> None:
    """Give a capture up; `moved` maps the paths of its frames to new ones: they are set aside and kept."""
    with journal.transaction("capture.discarded") as write:
        write.execute(
            "UPDATE captures SET state = 'discarded', reason = ? WHERE campaign = ? AND name = ?",
            reason,
            campaign,
            name,
        )
        for old, new in moved.items():
            write.execute("UPDATE frames SET path = ?, state = 'set_aside' WHERE path = ?", new, old)


def record_result(
    journal: Journal,
    campaign: str,
    members: Sequence[str],
    *,
    envelope: list[dict[str, Any]],
    measurements: list[dict[str, Any]],
    event: EnvelopeData,
    replace: bool = False,
) -> bool:
    """Keep an envelope and publish it, once: False, and nothing changed, if it had been kept before.

    `event` has the capture's name, or its group's; `members` are the captures that it was measured from. With `replace`
    an earlier result of this name gives way: a manual group that has a member more.
    """
    name = event.capture
    with journal.transaction("envelope") as write:
        if replace:
            write.execute("DELETE FROM results WHERE campaign = ? AND name = ?", campaign, name)
        elif write.execute("SELECT 1 FROM results WHERE campaign = ? AND name = ?", campaign, name).fetchone():
            return False
        number = write.execute("SELECT coalesce(max(number), 0) + 1 FROM results WHERE campaign = ?", campaign)
        write.execute(
            "INSERT INTO results VALUES (?, ?, ?, ?, ?)",
            campaign,
            name,
            number.fetchone()[0],
            _json(envelope),
            _json(measurements),
        )
        for member in members:
            write.execute("UPDATE captures SET state = 'measured' WHERE campaign = ? AND name = ?", campaign, member)
        _emit(write, "envelope", campaign, event)
    return True


def give_up_measuring(
    journal: Journal, campaign: str, members: Sequence[str], fault: FaultData, *, is_known: bool = False
) -> None:
    """Captures whose frames are stored but cannot be measured; they are kept, and reported as a fault.

    `is_known` leaves the event out: the same fault was reported for captures before.
    """
    with journal.transaction("capture.unmeasured") as write:
        for member in members:
            write.execute(
                "UPDATE captures SET state = 'unmeasured', reason = ? WHERE campaign = ? AND name = ?",
                fault.message or "",
                campaign,
                member,
            )
        if not is_known:
            _emit(write, "fault", campaign, fault)


def fault(journal: Journal, campaign: str | None, data: FaultData) -> None:
    """Report a fault; `data` says on which device, what happened and what is done about it."""
    with journal.transaction("fault") as write:
        _emit(write, "fault", campaign, data)


def keep_stamp(journal: Journal, campaign: str, stamp: str) -> None:
    """Note what a campaign's result files were like when it ended, so that a later loss shows."""
    with journal.transaction("results.stamped") as write:
        write.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", f"results:{campaign}", stamp)


def probe(journal: Journal) -> None:
    """Show that the journal can still be written, and nothing else."""
    with journal.transaction("probe") as write:
        write.execute("INSERT OR REPLACE INTO meta VALUES ('alive_at', ?)", write.at)


def _emit(write: Transaction, kind: str, campaign: str | None, data: EventPart) -> None:
    """Append an event of this kind; its model's JSON is stored as it is."""
    check_payload(kind, data)
    write.emit(kind, campaign, data.to_json_dict())


def _answer(write: Transaction, request_id: str | None, method: str, reply: Mapping[str, Any]) -> None:
    if request_id is not None:
        write.execute("INSERT OR REPLACE INTO requests VALUES (?, ?, ?)", request_id, method, json.dumps(reply))


def _json(rows: list[dict[str, Any]]) -> str:
    return json.dumps(rows, allow_nan=False, separators=(",", ":"))
