"""The queue between stored captures and published envelopes: order, bounds, groups, failures, a full disk."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.measurement_queue import CaptureRows, MeasurementQueue
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.recorder import Recorder
from labdaemon.clock import SimulatedClock
from labdaemon.errors import DataError, SetupError, StorageFull, StorageUnavailable, TransportError
from labdaemon.events import CaptureData
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import NO_STEP, CaptureRecord, FrameRecord
from labdaemon.testing.lab import FakeMeasurer

CAPTURE = CaptureRecord(
    "c", "a", 3, 0, "a", False, "s1", None, "intended", 5.0, 1.0, 0.5, None, {}, None, None, ("left",), {}, None,
)  # fmt: skip


class Lab:
    """A queue on a journal in simulated time; it observes its results."""

    def __init__(self, folder: Path, depth: int = 4) -> None:
        self.clock, self.folder = SimulatedClock(), folder / "campaigns" / "c"
        (self.folder / "sharp" / "s1").mkdir(parents=True)
        (self.folder / "sharp" / "s1" / "left.dng").touch()
        self.journal = Journal(folder, self.clock, synchronous="OFF")
        self.recorder = Recorder(self.journal, InlineExecutor("journal", lambda: 0.0))
        self.measurer = FakeMeasurer()
        self.queue = MeasurementQueue(self.recorder, self.measurer, self.clock, folder, depth=depth)
        self.queue.observer = self
        self.published: list[str] = []
        self.waited: list[str] = []

    def result_published(self, campaign: str, name: str, rows: Any) -> None:
        self.published.append(name)

    async def wait_for_disk(self, exc: StorageUnavailable) -> None:
        self.waited.append(str(exc))
        await asyncio.sleep(10.0)

    def stored(self, name: str, **changes: Any) -> CaptureRecord:
        capture = replace(CAPTURE, name=name, **changes)
        (self.folder / "captures" / name).mkdir(parents=True)
        (self.folder / "captures" / name / "left.dng").touch()
        transitions.intend_capture(self.journal, capture)
        transitions.fire_capture(
            self.journal,
            "c",
            name,
            opened_at="2026-05-04T10:00:00.000000Z",
            opening_s={},
            phase_rad=None,
            sd_phase_rad=None,
        )
        transitions.complete_capture(self.journal, "c", CaptureData(capture=name))
        return next(one for one in records.captures(self.journal, "c") if one.name == name)

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [event.data for event in self.journal.events_after(0, 1000) if event.kind == kind]


@pytest.fixture
def run(tmp_path: Path) -> Any:
    def start(scenario: Callable[[Lab], Coroutine[Any, Any, None]], depth: int = 4) -> Lab:
        lab = Lab(tmp_path, depth)

        async def main() -> None:
            try:
                await scenario(lab)
            finally:
                await lab.queue.cancel()
                lab.journal.close()

        lab.clock.run(main())
        return lab

    return start


def test_a_result_is_kept_published_and_observed(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.queue.add(lab.stored("a"))
        assert lab.queue.waiting == 1
        await lab.queue.drain()
        [event] = lab.events("envelope")
        assert (event["capture"], event["step"], event["frequency_hz"]) == ("a", 3, 5.0)
        assert event["opened_at"] == "2026-05-04T10:00:00.000000Z"
        assert records.captures(lab.journal, "c", "measured")[0].name == "a"
        assert lab.queue.waiting == 0

    assert run(scenario).published == ["a"]


def test_a_full_queue_makes_the_engine_wait(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.measurer.measure_s = 100.0
        for name in "abc":
            await lab.queue.add(lab.stored(name))
        assert lab.clock.monotonic() == pytest.approx(100.0), "the third waits until one of two is done"
        assert lab.queue.oldest_s() == pytest.approx(0.0, abs=100.0)
        await lab.queue.drain()

    assert sorted(run(scenario, 2).published) == ["a", "b", "c"]


def test_a_group_is_measured_once_all_its_captures_are_stored(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.queue.resume("c", {"g": 3})
        for shot, name in enumerate(("g-01", "g-02", "g-03")):
            await lab.queue.add(lab.stored(name, grouped="g", shot=shot))
            assert lab.queue.waiting == (shot == 2)
        await lab.queue.drain()

    lab = run(scenario)
    assert lab.published == ["g"]


def test_sharp_frames_and_members_of_manual_groups_are_not_measured_alone(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        await lab.queue.add(lab.stored("s", is_sharp=True))
        await lab.queue.add(lab.stored("m", step=NO_STEP, grouped="bolt"))
        assert lab.queue.waiting == 0

    run(scenario)


def test_a_group_that_has_a_member_more_is_measured_again(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        first, second = (lab.stored(name, step=NO_STEP, grouped="bolt") for name in ("m1", "m2"))
        await lab.queue.add_group([first])
        await lab.queue.add_group([first, second], again=True)
        await lab.queue.drain()
        assert [one.name for one in records.results(lab.journal, "c")] == ["bolt"]

    assert run(scenario).published == ["bolt", "bolt"]


class FailingMeasurer(FakeMeasurer):
    """Fails as often as errors were given."""

    def __init__(self, *errors: Exception) -> None:
        super().__init__()
        self.errors = list(errors)
        self.tries = 0

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        self.tries += 1
        if self.errors:
            raise self.errors.pop(0)
        return await super().measure(folder, sharp, captures, name)


@pytest.mark.parametrize(("errors", "tries", "is_measured"), [
    ([TransportError("a worker was killed")], 2, True),
    ([TransportError("killed"), TransportError("killed again")], 2, False),
    ([DataError("no sharp frames")], 1, False),
])  # fmt: skip
def test_only_what_may_pass_is_tried_again(run: Any, errors: list[Exception], tries: int, is_measured: bool) -> None:
    async def scenario(lab: Lab) -> None:
        lab.queue._measurer = measurer = FailingMeasurer(*errors)
        await lab.queue.add(lab.stored("a"))
        await lab.queue.drain()
        assert measurer.tries == tries
        assert (lab.published == ["a"]) is is_measured
        assert [fault["action"] for fault in lab.events("fault")] == [] if is_measured else ["kept"]
        assert records.captures(lab.journal, "c", "measured" if is_measured else "unmeasured")

    run(scenario)


def test_manual_captures_that_cannot_be_measured_are_one_fault(run: Any) -> None:
    """They may come all night, and always for the same reason."""

    async def scenario(lab: Lab) -> None:
        lab.queue._measurer = FailingMeasurer(*[DataError("no sharp frames")] * 5)
        for number in range(5):
            await lab.queue.add(lab.stored(f"m{number}", step=NO_STEP))
        await lab.queue.drain()
        assert len(lab.events("fault")) == 1
        assert len(records.captures(lab.journal, "c", "unmeasured")) == 5

    run(scenario)


def test_what_was_not_foreseen_breaks_the_queue_for_all(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.queue._measurer = FailingMeasurer(ZeroDivisionError("a slip"))
        await lab.queue.add(lab.stored("a"))
        with pytest.raises(ZeroDivisionError):
            await lab.queue.drain()
        with pytest.raises(ZeroDivisionError):
            await lab.queue.add(lab.stored("b"))

    run(scenario)


def test_a_result_waits_for_the_disk_and_is_not_measured_again(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        write, refusals = lab.recorder.write, [StorageFull("the disk is full")] * 3

        async def refuse(*args: Any, **kwargs: Any) -> Any:
            if refusals:
                raise refusals.pop()
            return await write(*args, **kwargs)

        capture = lab.stored("a")
        lab.recorder.write = refuse  # type: ignore[method-assign]
        await lab.queue.add(capture)
        await lab.queue.drain()
        assert len(lab.waited) == 3

    assert run(scenario).published == ["a"]


def test_first_frames_of_a_wrong_size_are_given_up(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        lab.measurer.wrong_size = "left has frames of 100 x 80"
        capture = lab.stored("a")
        transitions.store_frame(
            lab.journal,
            FrameRecord("c", "a", "left", "campaigns/c/captures/a/left.dng", "D.DNG", "t", 0, "ab", "stored"),
        )
        with pytest.raises(SetupError, match="100 x 80"):
            await lab.queue.add(capture)
        assert records.captures(lab.journal, "c", "discarded")[0].reason == "left has frames of 100 x 80"

    run(scenario)


def test_what_a_crash_left_stored_is_measured(run: Any) -> None:
    async def scenario(lab: Lab) -> None:
        for name in ("a", "b"):
            lab.stored(name)
        await lab.queue.enqueue_stored("c")
        await lab.queue.enqueue_stored("c")
        await lab.queue.drain()

    assert sorted(run(scenario).published) == ["a", "b"]
