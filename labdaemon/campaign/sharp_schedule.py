"""The order of a plan's steps: numbered, with fresh sharp sets where their schedule wants them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from labdaemon.campaign.steps import Step


@dataclass(frozen=True, slots=True)
class StepDraft:
    """A step before it is numbered, with the schedule that its sharp set starts."""

    step: Step
    every_steps: int | None = None
    every_s: float | None = None


def open_steps(like: Step, search: int, count: int) -> Iterator[StepDraft]:
    """Steps whose excitation is decided on the way, and a last one without captures that only ends their search.

    Parameters
    ----------
    like
        A step with the longest time that one may take.
    """
    label = like.label.rpartition("-")[0]
    step = replace(
        like, label=label, frequency_hz=None, amplitude_mm=None, precision=None, grouped=False, search=search
    )
    yield from [StepDraft(step)] * count
    yield StepDraft(replace(step, shots=(), predicted_s=0.0, predicted_bytes=0))


def _continues_search(steps: list[Step], step: Step) -> bool:
    """Whether a step belongs to the search of the step before it, which no sharp set interrupts."""
    return step.search is not None and bool(steps) and steps[-1].search == step.search


def with_sharp_sets(drafts: Iterator[StepDraft]) -> list[Step]:
    """Number the steps, put retaken sharp sets where their schedule wants them, and tell each step its set."""
    steps: list[Step] = []
    schedule: StepDraft | None = None
    sets = since_steps = 0
    since_s = 0.0

    def add(step: Step) -> None:
        nonlocal sets, since_steps, since_s
        index = len(steps)
        if step.kind == "sharp":
            sets, since_steps, since_s = sets + 1, 0, 0.0
        sharp_set = f"set-{sets:03d}" if sets > 1 else ""
        steps.append(replace(step, index=index, label=f"{index:05d}-{step.label}", sharp_set=sharp_set))
        if step.kind != "sharp":
            since_steps, since_s = since_steps + 1, since_s + step.predicted_s

    for draft in drafts:
        if draft.step.kind == "sharp":
            schedule = draft
        elif schedule is not None and draft.step.shots and not _continues_search(steps, draft.step):
            due = (schedule.every_steps is not None and since_steps >= schedule.every_steps) or (
                schedule.every_s is not None and since_s >= schedule.every_s
            )
            if due:
                add(schedule.step)
        add(draft.step)
    return steps
