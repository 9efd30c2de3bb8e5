"""The engine against a model of what a campaign may go through, by random commands, faults, kills and waits."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from labdaemon.bench.soak import OPERATIONS
from labdaemon.bench.verdict import judge
from labdaemon.campaign.retry import RetryPolicy
from labdaemon.clock import SimulatedClock
from labdaemon.journal import records
from labdaemon.stream.messages import CommandError
from labdaemon.testing.lab import FakeLab

CAMPAIGN = """
name = "model"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "steps"
frequency_hz = [5.0, 7.0]
amplitude_mm = 1.0
exposure_s = 1.0
"""
STEPS = 2
ACTIVE = ("running", "paused")
NEXT = {
    None: {"campaign.started", "campaign.aborted", "campaign.paused"},
    "campaign.started": {"campaign.paused", "campaign.completed", "campaign.aborted", "campaign.failed"},
    "campaign.resumed": {"campaign.paused", "campaign.completed", "campaign.aborted", "campaign.failed"},
    "campaign.paused": {"campaign.resumed", "campaign.started", "campaign.aborted"},
}
"""Which event of a campaign may follow which; nothing follows its end."""

FAULTS = st.sampled_from([(operation, kind) for operation, kinds in OPERATIONS.items() for kind in kinds])


class EngineMachine(RuleBasedStateMachine):
    """Whatever happens, the journal tells a possible story, and a paused table rests."""

    @initialize()
    def begin(self) -> None:
        self.clock = SimulatedClock()
        self.runner = self.clock.runner()
        self.folder = Path(tempfile.mkdtemp(prefix="labdaemon-model-"))
        self.lab = FakeLab(self.folder, self.clock, policy=RetryPolicy(max_tries=3))
        self.submitted: list[str] = []
        self.asked_to_pause: set[str] = set()
        self.run(self._start())

    def run(self, coroutine):
        return self.runner.run(coroutine)

    async def _start(self) -> None:
        self.lab.start()

    def states(self) -> dict[str, str]:
        return {record.id: record.state for record in records.campaigns(self.lab.journal) if record.number}

    def active(self) -> str | None:
        """The campaign under way: the first that has not ended; None before the engine has taken one up."""
        current = self.lab.engine.current
        return current.id if current is not None else None

    @rule()
    def submit(self) -> None:
        if len(self.submitted) < 3:
            self.submitted.append(self.run(self.lab.submit(CAMPAIGN)))

    @rule(seconds=st.sampled_from([0.1, 0.7, 2.0, 5.0, 11.0, 60.0]))
    def wait(self, seconds: float) -> None:
        self.run(self.clock.sleep(seconds))

    @rule()
    def pause(self) -> None:
        self._command(self.lab.engine.pause, {"running"})

    @rule()
    def resume(self) -> None:
        self._command(self.lab.engine.resume, {"paused"})

    @rule()
    def abort(self) -> None:
        self._command(self.lab.engine.abort, {"running", "paused", "queued"})

    @rule()
    def stop(self) -> None:
        self.run(self.lab.engine.stop())
        assert not self.lab.world.moves()

    @rule(fault=FAULTS)
    def fail(self, fault) -> None:
        self.lab.world.fail(*fault)

    @rule()
    def kill(self) -> None:
        self.run(self.lab.kill())
        self.run(self._start())

    @invariant()
    def one_at_a_time(self) -> None:
        active = [id for id, state in self.states().items() if state in ACTIVE]
        assert len(active) <= 1
        for id, state in self.states().items():
            if active and id < active[0]:
                assert state not in ("queued", *ACTIVE)

    @invariant()
    def the_story_is_possible(self) -> None:
        events = self.lab.journal.events_after(0, 10_000)
        assert [event.seq for event in events] == list(range(1, len(events) + 1))
        last: dict[str, str] = {}
        for event in events:
            if event.kind.startswith("campaign.") and event.campaign is not None:
                assert event.kind in NEXT.get(last.get(event.campaign), set()), (last.get(event.campaign), event.kind)
                last[event.campaign] = event.kind
        told = Counter((event.campaign, event.data["step"]) for event in events if event.kind == "envelope")
        assert not told or max(told.values()) == 1

    def teardown(self) -> None:
        """Left alone, with every pause ended, everything that was not aborted completes, and no frame is missing."""
        try:
            self.run(self._finish())
            self.one_at_a_time()
            self.the_story_is_possible()
            states = self.states()
            assert set(states.values()) <= {"completed", "aborted"}
            told = Counter(
                event.campaign for event in self.lab.journal.events_after(0, 10_000) if event.kind == "envelope"
            )
            assert all(told[id] == STEPS for id, state in states.items() if state == "completed")
            assert not self.lab.world.running
            cameras = self.lab.fake.cameras
            self.run(self.lab.kill())
            taken, on_cards = sum(len(body.made) for body in cameras), sum(len(body.card) for body in cameras)
            verdict = judge(self.folder, taken=taken, on_cards=on_cards, captures=0, has_files=False)
            assert verdict.frames_lost == verdict.results_repeated == verdict.seq_gaps == verdict.stray_parts == 0
        finally:
            self.runner.close()
            shutil.rmtree(self.folder, ignore_errors=True)

    async def _finish(self) -> None:
        self.lab.world.faults.clear()
        for _ in range(200):
            states = self.states().values()
            if not any(state in ("queued", *ACTIVE) for state in states):
                return
            if "paused" in states and self.lab.engine.current is not None:
                await self.lab.engine.resume()
            await self.clock.sleep(60.0)
        raise AssertionError(f"not over after hours: {self.states()}")

    def _command(self, command, allowed: set[str]) -> None:
        """A command must work in the states that it is for, and be refused in all others."""
        id = self.active()
        before = self.states().get(id) if id is not None else None
        try:
            self.run(command())
        except CommandError:
            assert before not in allowed
        else:
            assert before in allowed


EngineMachine.TestCase.settings = settings(
    max_examples=12, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck), print_blob=True
)
TestEngineAgainstTheModel = EngineMachine.TestCase


def test_between_two_runs_no_time_passes():
    clock = SimulatedClock()
    with clock.runner() as runner:
        woken: list[float] = []

        async def begin() -> None:
            async def wake() -> None:
                await clock.sleep(5.0)
                woken.append(clock.monotonic())

            begin.task = asyncio.create_task(wake())

        runner.run(begin())
        assert woken == []
        runner.run(clock.sleep(10.0))
        assert woken == [5.0]
