"""What the daemon tells of itself, every second and when asked. Cheap: it is made on the event loop."""

from __future__ import annotations

from typing import Any

from labdaemon.campaign.engine import Engine
from labdaemon.journal import records


def status_of(engine: Engine) -> dict[str, Any]:
    """State, campaign, step, captures, time left, largest amplitude, faults; None for what is not known."""
    record, plan, step = engine.current, engine.plan, engine.step
    journal = engine.lab.recorder.journal
    told: dict[str, Any] = {
        "state": "idle" if record is None else ("paused" if record.state == "paused" else "running"),
        "doing": engine.attempts.doing,
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
        "left_s": None,
        "largest_mm": engine.largest_mm,
        "faults": engine.reporter.faults,
        "last_fault": engine.reporter.last_fault,
        "queue": records.count_campaigns(journal, "queued"),
        "measuring": engine.measuring.waiting,
        "table": "moving" if engine.lab.table.excitation is not None else "rest",
    }
    if record is not None and plan is not None:
        told["captures"] = records.count_captures(journal, record.id)
        told["captures_total"] = sum(len(step.shots) for step in plan.steps)
        told["left_s"] = round(sum(later.predicted_s for later in plan.steps[step.index if step else 0 :]), 1)
    return told
