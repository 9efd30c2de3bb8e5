"""The journal against a model in memory: random transitions, failures between, and openings anew."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, invariant, multiple, rule

from labdaemon.clock import SimulatedClock
from labdaemon.events import CaptureData, EnvelopeData, FaultData
from labdaemon.journal import records, transitions
from labdaemon.journal.card_records import CardIdentity
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import CaptureRecord, FrameRecord
from labdaemon.journal.transitions import WAYS_TO


class Crash(BaseException):
    """Comes between a transition's statements and its commit."""


def order(campaign: str, name: str) -> CaptureRecord:
    return CaptureRecord(
        campaign, name, 0, 0, "label", False, None, None, "intended", 5.0, 1.0, 1.0, None, {}, None, None,
        ("left", "right"), {}, None,
    )  # fmt: skip


class JournalMachine(RuleBasedStateMachine):
    """What was committed is there, once, in order, whatever came between; what was not is not."""

    campaigns = Bundle("campaigns")
    captures = Bundle("captures")

    @initialize()
    def begin(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="labdaemon-journal-"))
        self.clock = SimulatedClock()
        self.journal = Journal(self.folder, self.clock, synchronous="OFF")
        self.uuid = self.journal.uuid
        self.kinds: list[str] = []
        self.states: dict[str, str] = {}
        self.started: set[str] = set()
        self.capture_states: dict[tuple[str, str], str] = {}
        self.frames: dict[tuple[str, str, str], str] = {}
        self.results: dict[str, list[str]] = {}
        self.requests: dict[str, str] = {}

    @rule(target=campaigns, request=st.none() | st.sampled_from(["a", "b"]))
    def submit(self, request):
        id = transitions.submit(self.journal, "Näme / x", "toml", "digest", request)
        if request in self.requests:
            assert id == self.requests[request]
            return multiple()
        assert id not in self.states
        self.states[id] = "queued"
        if request is not None:
            self.requests[request] = id
        return id

    @rule(id=campaigns, state=st.sampled_from(list(WAYS_TO)))
    def move(self, id, state) -> None:
        moved = transitions.move_campaign(self.journal, id, state, "because")
        assert moved == (self.states[id] in WAYS_TO[state])
        if moved:
            kind = transitions.CAMPAIGN_EVENTS[state]
            self.kinds.append("campaign.resumed" if state == "running" and id in self.started else kind)
            self.started |= {id} if state == "running" else set()
            self.states[id] = state

    @rule(target=captures, id=campaigns)
    def intend(self, id):
        name = f"c{len(self.capture_states):03d}"
        transitions.intend_capture(self.journal, order(id, name))
        self.capture_states[id, name] = "intended"
        return id, name

    @rule(capture=captures)
    def fire(self, capture) -> None:
        if self.capture_states[capture] == "discarded":
            return  # nothing becomes of it any more
        transitions.fire_capture(
            self.journal, *capture, opened_at="now", opening_s={"left": 0.1}, phase_rad=None, sd_phase_rad=None
        )
        self.capture_states[capture] = "fired"

    @rule(capture=captures)
    def expose(self, capture) -> None:
        if self.capture_states[capture] == "discarded":
            return  # nothing becomes of it any more
        transitions.expose_capture(self.journal, *capture, {"left": CardIdentity("DSC_1", "t")})
        self.capture_states[capture] = "exposed"

    @rule(capture=captures, camera=st.sampled_from(["left", "right"]))
    def store(self, capture, camera) -> None:
        if self.capture_states[capture] == "discarded":
            return
        path = f"{capture[0]}/{capture[1]}/{camera}.dng"
        transitions.store_frame(
            self.journal, FrameRecord(*capture, camera, path, "DSC_1", "t", 10, "ab" * 32, "stored")
        )
        self.frames[(*capture, camera)] = path

    @rule(capture=captures)
    def complete(self, capture) -> None:
        if self.capture_states[capture] == "discarded":
            return  # nothing becomes of it any more
        transitions.complete_capture(self.journal, capture[0], CaptureData(capture=capture[1]))
        self.capture_states[capture] = "stored"
        self.kinds.append("capture.completed")

    @rule(capture=captures)
    def record(self, capture) -> None:
        id, name = capture
        if self.capture_states[capture] == "discarded":
            return
        kept = transitions.record_result(
            self.journal, id, [name], envelope=[{"ax_mm": 0.25}], measurements=[], event=EnvelopeData(capture=name)
        )
        assert kept == (name not in self.results.get(id, []))
        if kept:
            self.results.setdefault(id, []).append(name)
            self.capture_states[capture] = "measured"
            self.kinds.append("envelope")

    @rule(capture=captures)
    def discard(self, capture) -> None:
        moved = {path: f"set_aside/{path}" for (*owner, _), path in self.frames.items() if tuple(owner) == capture}
        if any(path.startswith("set_aside") for path in moved):
            return
        transitions.discard_capture(self.journal, *capture, "interrupted", moved)
        for key, path in list(self.frames.items()):
            if key[:2] == capture:
                self.frames[key] = moved[path]
        self.capture_states[capture] = "discarded"

    @rule(id=campaigns)
    def crash_before_the_commit(self, id) -> None:
        def crash(name: str) -> None:
            if name == "before fault":
                raise Crash

        self.journal.listen(crash)
        try:
            transitions.fault(self.journal, id, FaultData(message="never kept"))
        except Crash:
            self.reopen()
        else:
            raise AssertionError("it did not crash")

    @rule()
    def reopen(self) -> None:
        self.journal.close()
        self.journal = Journal(self.folder, self.clock, synchronous="OFF")

    @rule(seconds=st.sampled_from([-1e4, 1.0, 1e6]))
    def jump(self, seconds) -> None:
        self.clock.jump(seconds)

    @invariant()
    def it_agrees_with_the_model(self) -> None:
        assert self.journal.uuid == self.uuid
        events = self.journal.events_after(0, 10_000)
        assert [event.seq for event in events] == list(range(1, len(self.kinds) + 1))
        assert [event.kind for event in events] == self.kinds
        assert self.journal.last_seq == len(self.kinds)
        assert {record.id: record.state for record in records.campaigns(self.journal)} == self.states
        assert {
            (capture.campaign, capture.name): capture.state for capture in records.captures(self.journal)
        } == self.capture_states
        paths = {frame.path for id, name in self.capture_states for frame in records.frames(self.journal, id, name)}
        assert paths == set(self.frames.values())
        for id in self.states:
            assert [result.name for result in records.results(self.journal, id)] == self.results.get(id, [])

    def teardown(self) -> None:
        if hasattr(self, "journal"):
            self.journal.close()
            shutil.rmtree(self.folder, ignore_errors=True)


JournalMachine.TestCase.settings = settings(
    max_examples=15, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck)
)
TestJournalAgainstTheModel = JournalMachine.TestCase
