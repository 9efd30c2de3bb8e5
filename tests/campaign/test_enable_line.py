"""The enable line and campaigns: none moves the table unattended before the line was seen to stop it."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign import enable_line as module
from labdaemon.campaign.disk import DataDisk
from labdaemon.campaign.enable_line import EnableLine
from labdaemon.campaign.reporter import CampaignReporter
from labdaemon.campaign.steps import Plan, SettleRule, Step
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.enable_line_proof import LineUnproven
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.table import Table
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DeviceError, InterlockError
from labdaemon.journal.journal import Journal
from labdaemon.service.enable_line_note import sentence
from labdaemon.stream.messages import WrongStateError
from labdaemon.testing.rig import FakeRig, fake_rig

MOVES = Step(1, 0, "dwell", "s1", 5.0, 1.0, (), False, SettleRule(), "retry", 10.0, 0)
RESTS = replace(MOVES, index=0, kind="sharp", frequency_hz=None, amplitude_mm=None)
STILL = replace(MOVES, amplitude_mm=0.0)


def plan(*steps: Step) -> Plan:
    return Plan("night", steps, "", "")


class Lab:
    """An enable line on the fake rig; its proof is what a test says."""

    def __init__(self, folder: Path, is_accepted: bool, change: Callable[[FakeRig], None]) -> None:
        self.clock = SimulatedClock()
        self.fake = fake_rig(self.clock)
        change(self.fake)
        self.journal = Journal(folder, self.clock, synchronous="OFF")
        recorder = Recorder(self.journal, InlineExecutor("journal", lambda: 0.0))
        self.table = Table(self.fake.rig, self.clock, None)
        context = AcquisitionContext(self.fake.rig, self.table, recorder, self.clock, folder)
        self.reporter = CampaignReporter(recorder, self.clock, DataDisk(recorder, lambda: 10**12, 10**9))
        self.line = EnableLine(context, self.reporter, is_accepted)
        self.proofs = 0
        self.outcome: Exception | None = None

    async def prove(self, *_: Any) -> None:
        self.proofs += 1
        if self.outcome is not None:
            if isinstance(self.outcome, LineUnproven):
                self.table.observer.proof = "failed"
            raise self.outcome
        self.table.observer.proof = "proven"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    def start(
        scenario: Callable[[Lab], Coroutine[Any, Any, None]],
        *,
        is_accepted: bool = False,
        change: Callable[[FakeRig], None] = lambda fake: None,
    ) -> Lab:
        lab = Lab(tmp_path, is_accepted, change)
        monkeypatch.setattr(module, "prove_enable_line", lab.prove)
        try:
            lab.clock.run(scenario(lab))
        finally:
            lab.journal.close()
        return lab

    return start


def without_gauges(fake: FakeRig) -> None:
    fake.rig = replace(fake.rig, gauges=())


def without_shaker(fake: FakeRig) -> None:
    fake.rig = replace(fake.rig, shaker=None)


def test_a_campaign_is_let_in_once_the_line_is_proven_and_it_is_proven_once(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        assert lab.line.state == "untried"
        await lab.line.admit(plan(RESTS, MOVES), is_idle=True)
        await lab.line.admit(plan(MOVES), is_idle=True)
        await lab.line.check_before(MOVES)
        assert lab.line.state == "proven"

    assert run(scenario).proofs == 1


def test_a_campaign_that_moves_nothing_needs_no_line(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.line.admit(plan(RESTS, STILL), is_idle=True)
        for step in (RESTS, STILL):
            await lab.line.check_before(step)

    assert run(scenario).proofs == 0


def test_while_another_campaign_runs_the_proof_waits_for_its_turn(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.line.admit(plan(MOVES), is_idle=False)
        assert lab.proofs == 0
        await lab.line.check_before(MOVES)

    assert run(scenario).proofs == 1


def test_a_line_that_stops_nothing_lets_no_campaign_in(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.outcome = LineUnproven("the table moved on")
        with pytest.raises(WrongStateError, match="accept_no_enable"):
            await lab.line.admit(plan(MOVES), is_idle=True)
        with pytest.raises(LineUnproven):
            await lab.line.check_before(MOVES)

    run(scenario)


def test_a_device_that_does_not_answer_is_the_campaigns_own_to_try_again(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.outcome = DeviceError("no answer", device="trigger")
        await lab.line.admit(plan(MOVES), is_idle=True)
        with pytest.raises(DeviceError):
            await lab.line.check_before(MOVES)

    run(scenario)


def test_a_rig_that_cannot_prove_it_needs_a_persons_word(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        assert lab.line.state == "impossible"
        with pytest.raises(WrongStateError, match="accept_no_enable = true"):
            await lab.line.admit(plan(MOVES), is_idle=True)
        with pytest.raises(InterlockError, match="accept_no_enable = true"):
            await lab.line.check_before(MOVES)

    run(scenario, change=without_gauges)

    async def accepted(lab: Lab) -> None:
        await lab.line.admit(plan(MOVES), is_idle=True)
        await lab.line.check_before(MOVES)

    assert run(accepted, is_accepted=True, change=without_gauges).proofs == 0


def test_a_failed_proof_that_is_accepted_is_reported_once(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.outcome = LineUnproven("the table moved on")
        await lab.line.check_before(MOVES)
        await lab.line.check_before(MOVES)
        [fault] = [event.data for event in lab.journal.events_after(0, 10)]
        assert fault["action"] == "go on, as accept_no_enable says"

    assert run(scenario, is_accepted=True).proofs == 1


def test_a_table_of_others_has_no_line_of_ours(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        assert lab.line.state is None
        await lab.line.admit(plan(MOVES), is_idle=True)
        await lab.line.check_before(MOVES)

    assert run(scenario, change=without_shaker).proofs == 0


@pytest.mark.parametrize(("line", "words"), [
    (None, None),
    ({"can_be_proven": True, "accept_no_enable": False}, "proven before the table moves"),
    ({"can_be_proven": False, "accept_no_enable": True}, "nothing but the shaker stops the table"),
    ({"can_be_proven": False, "accept_no_enable": False}, "`submit` refuses"),
])  # fmt: skip
def test_a_plan_says_what_will_be_asked_of_the_line(line: dict[str, bool] | None, words: str | None) -> None:
    said = sentence(line)
    assert (said is None) if words is None else (said is not None and words in said)
