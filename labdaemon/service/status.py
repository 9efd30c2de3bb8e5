"""What the daemon reports of itself, every second and when asked. Cheap: it is made on the event loop."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labdaemon.campaign.engine import Engine
from labdaemon.campaign.steps import Plan
from labdaemon.journal import records, transitions
from labdaemon.journal.records import NO_STEP


def place_of(rig: Path, data: Path) -> dict[str, Any]:
    """Which daemon this is: rig file, data folder, host and process. A person with two rigs reads it before acting."""
    return {"rig": str(rig.resolve()), "data": str(data), "host": socket.gethostname(), "pid": os.getpid()}


def status_of(engine: Engine, place: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """State, campaign, step, captures, time left, largest motion, faults; None for what is not known.

    Parameters
    ----------
    engine
        What is asked.
    place
        Of `place_of`, added as it is.
    """
    record, plan, step = engine.current, engine.plan, engine.step
    journal, largest = engine.context.recorder.journal, engine.largest
    taken = records.captures_by_step(journal, record.id if record is not None else transitions.MANUAL)
    report: dict[str, Any] = {
        "state": "idle" if record is None else ("paused" if record.state == "paused" else "running"),
        "doing": engine.step_runner.activity,
        "campaign": record.id if record else None,
        "name": record.name if record else None,
        "reason": record.reason if record else None,
        "step": step.index if step else None,
        "steps": len(plan.steps) if plan else None,
        "label": step.label if step else None,
        "kind": step.kind if step else None,
        "frequency_hz": step.frequency_hz if step else None,
        "amplitude_mm": step.amplitude_mm if step else None,
        "captures": None,
        "captures_total": None,
        "captures_manual": taken.get(NO_STEP, 0),
        "captures_expected": engine.manual.expected,
        "left_s": None,
        "largest_mm": largest.size_mm if largest else None,
        "largest_target": largest.target if largest else None,
        "doubtful": largest.doubtful if largest else None,
        "doubtful_mm": largest.doubtful_mm if largest else None,
        "waiting_for": {"disk": trouble} if (trouble := engine.reporter.disk_trouble) is not None else {},
        "faults": engine.reporter.faults,
        "last_fault": engine.reporter.last_fault,
        "queue": records.count_campaigns(journal, "queued"),
        "measuring": engine.queue.waiting,
        "table": engine.context.table.state,
        "enable_line": engine.enable_line.state,
        "accept_no_enable": engine.enable_line.is_accepted if engine.enable_line.state is not None else None,
        **(place or {}),
    }
    if record is not None and plan is not None:
        planned = {one.index: len(one.shots) for one in plan.steps}
        done = {index: min(count, planned.get(index, 0)) for index, count in taken.items()}
        report["captures"] = sum(done.values())
        report["captures_total"] = sum(planned.values())
        report["captures_manual"] = sum(taken.values()) - report["captures"]
        report["left_s"] = round(_left_s(engine, plan), 1)
    return report


def _left_s(engine: Engine, plan: Plan) -> float:
    """Predicted time of what is still to be done; within a step it follows the clock, down to nothing."""
    index = engine.step.index if engine.step is not None else 0
    later_s = sum(step.predicted_s for step in plan.steps if step.index > index)
    present_s = sum(step.predicted_s for step in plan.steps if step.index == index)
    if engine.step_runner.began_s is not None and engine.step is not None:
        present_s -= engine.context.clock.monotonic() - engine.step_runner.began_s
    return later_s + max(present_s, 0.0)
