"""One capture on the fake rig: what its observer learns, in which order, and what the journal has then."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import FrozenInstanceError, dataclass, field, replace
from pathlib import Path

import pytest

from labdaemon.capture.acquisition import acquire
from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.device_executor import InlineExecutor
from labdaemon.capture.external import ExternalReleases, store_release
from labdaemon.capture.pairing import ReleasePairing
from labdaemon.capture.recorder import Recorder
from labdaemon.capture.request import CaptureRequest
from labdaemon.capture.settle import Excitation
from labdaemon.capture.table import Table
from labdaemon.clock import SimulatedClock
from labdaemon.errors import InterlockError
from labdaemon.journal import records, transitions
from labdaemon.journal.journal import Journal
from labdaemon.journal.records import NO_STEP, CaptureRecord
from labdaemon.testing.rig import FakeRig, fake_rig

EXCITATION = Excitation(5.0, 2.0)


@dataclass
class Observer:
    context: AcquisitionContext
    calls: list[str] = field(default_factory=list)

    def capture_started(self) -> None:
        assert not records.captures(self.context.recorder.journal, None)
        self.calls.append("started")

    def capture_fired(self, capture: CaptureRecord) -> None:
        self.calls.append(f"fired {capture.state}")

    async def describe(self, capture: CaptureRecord) -> CaptureRecord:
        self.calls.append("describe")
        return replace(capture, amplitude_mm=2.5)

    async def capture_stored(self, capture: CaptureRecord) -> None:
        self.calls.append(f"stored {capture.state} {capture.amplitude_mm:g} mm")

    def capture_ended(self) -> None:
        self.calls.append("ended")


def run(folder: Path, scenario: Callable[[FakeRig, Observer, CaptureRequest], Awaitable[None]]) -> None:
    clock = SimulatedClock()
    fake = fake_rig(clock)
    journal = Journal(folder, clock, synchronous="OFF")

    async def main() -> None:
        recorder = Recorder(journal, InlineExecutor("journal", lambda: 0.0))
        campaign = await recorder.write(transitions.open_manual)
        context = AcquisitionContext(fake.rig, Table(fake.rig, clock, None), recorder, clock, folder)
        request = CaptureRequest(
            campaign=campaign,
            name="one",
            step=NO_STEP,
            shot=0,
            label="one",
            is_sharp=False,
            sharp=None,
            group=None,
            frequency_hz=5.0,
            amplitude_mm=2.0,
            exposure_s=1.0,
            cameras=tuple(fake.rig.cameras),
        )
        await scenario(fake, Observer(context), request)

    clock.run(main())
    journal.close()


def state_of(observer: Observer) -> str:
    [capture] = records.captures(observer.context.recorder.journal, None)
    return capture.state


def test_an_observer_follows_a_capture_to_the_end(tmp_path: Path) -> None:
    async def scenario(fake: FakeRig, observer: Observer, request: CaptureRequest) -> None:
        capture = await acquire(observer.context, replace(request, excitation=EXCITATION), observer)
        assert observer.calls == ["started", "fired fired", "describe", "stored stored 2.5 mm"]
        assert state_of(observer) == capture.state == "stored"
        assert fake.world.frequency_hz == 5.0
        assert all(not camera.card for camera in fake.cameras)

    run(tmp_path, scenario)


def test_a_request_is_no_record_and_stays_as_it_is(tmp_path: Path) -> None:
    async def scenario(fake: FakeRig, observer: Observer, request: CaptureRequest) -> None:
        stated = replace(request, stated_phase_rad=0.7)
        capture = await acquire(observer.context, stated, observer)
        assert capture.phase_rad == 0.7  # the trigger device's own phase has another reference
        assert stated.intended() == replace(
            capture, state="intended", opened_at=None, opening_s={}, sd_phase_rad=None, files={}, amplitude_mm=2.0
        )
        with pytest.raises(FrozenInstanceError):
            stated.name = "two"  # type: ignore[misc]

    run(tmp_path, scenario)


def test_a_capture_whose_table_was_stopped_is_not_stored(tmp_path: Path) -> None:
    async def scenario(fake: FakeRig, observer: Observer, request: CaptureRequest) -> None:
        def stop(capture: CaptureRecord) -> None:
            observer.context.table.excitation = None

        observer.capture_fired = stop  # type: ignore[method-assign]
        with pytest.raises(InterlockError, match="stopped during the exposure"):
            await acquire(observer.context, replace(request, excitation=EXCITATION), observer)
        assert observer.calls == ["started"]
        assert state_of(observer) == "fired"

    run(tmp_path, scenario)


def test_an_outside_release_is_followed_too(tmp_path: Path) -> None:
    async def scenario(fake: FakeRig, observer: Observer, request: CaptureRequest) -> None:
        context = observer.context
        releases = ExternalReleases(context, request.campaign, ReleasePairing(request.cameras, 5.0)).until(None)

        def release(operation: str) -> None:  # once somebody waits for it
            if operation == "trigger.wait" and context.clock.monotonic() > 2.0 and not fake.cameras[0].made:
                fake.trigger.edge(1.0)

        fake.world.on_call = release
        found = await anext(releases)
        await store_release(context, request, found, observer)
        await releases.aclose()
        assert observer.calls == ["started", "fired fired", "describe", "ended", "stored stored 2.5 mm", "ended"]
        assert state_of(observer) == "stored"

    run(tmp_path, scenario)
