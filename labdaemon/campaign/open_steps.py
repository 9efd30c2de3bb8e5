"""The plan of a campaign as far as its searches for modes have decided it.

Plan and decisions are all there is: a daemon that was killed has the same plan again when it starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from labdaemon.campaign.steps import Plan, Step
from labdaemon.events import DecisionData


def with_decisions(plan: Plan, decisions: Mapping[int, DecisionData]) -> Plan:
    """The plan with the excitation of each step that was decided, and without those that a search did not need.

    Parameters
    ----------
    plan
        As the campaign file makes it.
    decisions
        Of the journal, by the index of their step.

    Raises
    ------
    LimitError
        A decided step is beyond a limit of the rig as it is now.
    """
    steps: list[Step] = []
    ended: set[int] = set()
    for step in plan.steps:
        decision = decisions.get(step.index)
        if not step.is_open or step.search is None:
            steps.append(step)
        elif step.search in ended:
            continue
        elif decision is None:
            steps.append(step)
        elif decision.frequency_hz is None or decision.amplitude_mm is None:
            ended.add(step.search)
        else:
            make = plan.searches[step.search].make_step
            steps.append(make(step, decision.frequency_hz, decision.amplitude_mm, decision.hold_s))
    return replace(plan, steps=tuple(steps))


def group_sizes(plan: Plan) -> dict[str, int]:
    """How many captures each group of a plan has, by the group's name."""
    return {step.label: len(step.shots) for step in plan.steps if step.grouped}
