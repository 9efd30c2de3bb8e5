"""The way of a capture, measured: the files from the engine to the published event, and the calls that climb.

`python tests/capture_path.py` prints them; `tests/campaign/test_capture_path.py` holds the figures.

A campaign of a sharp frame and one step runs in the fake laboratory, and the interpreter reports every call. For each
landmark of the step's one capture (each call of shaker, trigger and cameras, each transition of the journal, the call
that measures, the call that wakes the publisher) the stack is taken, down from the engine; where a task was started,
the stack that started it comes before its own.

File
    A module of labdaemon on one of these stacks: what a reader opens to follow the capture. The fakes of the
    laboratory stand for drivers and measurer, and are left out.
Climb
    A module that calls, by a name that its own code holds, a module which imports it (directly or by way of others): a
    call against the direction of imports, by way of an observer or a callback. Functions and coroutines that are only
    carried (by an executor's thread, a gathering of tasks) stand where they are carried from, and are none.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
from collections.abc import Coroutine
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import grimp

import labdaemon
from labdaemon.clock import SimulatedClock
from labdaemon.stream.publisher import EventPublisher
from labdaemon.testing.lab import FakeLab

PACKAGE = Path(labdaemon.__file__).parent
CAMPAIGN = """
name = "one"
[[phase]]
kind = "sharp"
[[phase]]
kind = "steps"
frequency_hz = [5.0]
amplitude_mm = [2.0]
exposure_s = 1.0
"""
DEVICES = ("FakeShaker.", "FakeTrigger.", "FakeCamera.")
START = "RetryingStepRunner.run"
"""The step's first call; landmarks before it belong to the sharp frame."""
ENGINE = "labdaemon.campaign.engine"


@dataclass(frozen=True)
class Call:
    """A function on a stack, and the names that its code holds."""

    module: str
    function: str
    names: frozenset[str]


Stack = list[Call]


@cache
def module_of(code: CodeType) -> str | None:
    """Dotted name of labdaemon's module that this code is of; None for other packages."""
    path = Path(code.co_filename)
    if PACKAGE not in path.parents:
        return None
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def call_of(frame: FrameType) -> Call | None:
    """What runs in a frame; None for other packages and for the event loop of simulated time."""
    module = module_of(frame.f_code)
    if module is None or module == "labdaemon.clock":
        return None
    return Call(module, frame.f_code.co_qualname, frozenset(frame.f_code.co_names))


@dataclass
class PathTracer:
    """Collects stacks at the landmarks of one capture.

    Attributes
    ----------
    landmarks
        The stack at each landmark, outermost call first.
    """

    landmarks: list[Stack] = field(default_factory=list)
    _starts: dict[int, Stack] = field(default_factory=dict)
    _tasks: list[asyncio.Task[Any]] = field(default_factory=list)
    _is_on: bool = False

    def make_task(self, loop: asyncio.AbstractEventLoop, coroutine: Coroutine[Any, Any, Any], **more: Any) -> Any:
        """Start a task, and remember from where."""
        task = asyncio.Task(coroutine, loop=loop, **more)
        self._starts[id(task)] = self._stack(sys._getframe(1))
        self._tasks.append(task)  # kept, so that no other task gets its id
        return task

    def follow(self, frame: FrameType, event: str, argument: Any) -> None:
        """Profile function: called for every call."""
        call = call_of(frame) if event == "call" else None
        if call is None:
            return
        if call.function == START and frame.f_locals["step"].kind == "steps":
            self._is_on = True
        if self._is_on and self._is_landmark(call):
            stack = self._stack(frame)
            if any(one.module == ENGINE for one in stack) and not any("monitor" in one.module for one in stack):
                self.landmarks.append(stack)

    def _is_landmark(self, call: Call) -> bool:
        name = call.function
        if call.module == "labdaemon.journal.transitions":
            return not name.startswith("_")
        return name.startswith(DEVICES) or name in {"FakeMeasurer.measure", "Transaction.emit", "EventPublisher.wake"}

    def _stack(self, frame: FrameType | None) -> Stack:
        calls: Stack = []
        while frame is not None:
            call = call_of(frame)
            if call is not None:
                calls.insert(0, call)
            frame = frame.f_back
        try:
            task = asyncio.current_task()
        except RuntimeError:  # the loop does not run yet, or no longer
            return calls
        return self._starts.get(id(task), []) + calls


@dataclass(frozen=True)
class CapturePath:
    """What a reader has to follow.

    Attributes
    ----------
    landmarks
        Functions at which the way was looked at.
    files
        Modules on the way.
    climbs
        Calls against the direction of imports: from which module to which.
    """

    landmarks: tuple[str, ...]
    files: tuple[str, ...]
    climbs: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        lines = [f"{len(self.files)} files", *(f"  {name}" for name in self.files), f"{len(self.climbs)} climbs"]
        return "\n".join([*lines, *(f"  {lower} calls {upper}" for lower, upper in self.climbs)])


def trace(data: Path) -> PathTracer:
    """Run the campaign in the fake laboratory, whose journal lies in this folder."""
    tracer, clock = PathTracer(), SimulatedClock()
    lab = FakeLab(data, clock)

    async def scenario() -> None:
        asyncio.get_running_loop().set_task_factory(tracer.make_task)
        lab.start()
        publisher = EventPublisher("tcp://127.0.0.1:0", lab.journal, dict, clock)  # not bound: only its wake is asked
        lab.engine.context.recorder.observers = [publisher]
        id = await lab.submit(CAMPAIGN)
        await lab.until(id)
        publisher.close()
        await lab.kill()

    earlier = sys.getprofile()
    sys.setprofile(tracer.follow)
    try:
        clock.run(scenario())
    finally:
        sys.setprofile(earlier)
    return tracer


def measure() -> CapturePath:
    """Files and climbs on the way of a capture."""
    with tempfile.TemporaryDirectory() as folder:
        stacks = trace(Path(folder)).landmarks
    graph = grimp.build_graph("labdaemon")
    climbs = set()
    for stack in stacks:
        for lower, upper in pairwise(stack):
            is_named = upper.function.rsplit(".", 1)[-1] in lower.names
            is_fake = upper.module.startswith("labdaemon.testing")
            if is_named and not is_fake and lower.module != upper.module:
                above = graph.find_upstream_modules(upper.module)
                below = graph.find_upstream_modules(lower.module)
                if lower.module in above or upper.module not in below:
                    climbs.add((lower.module, upper.module))
    files = {call.module for stack in stacks for call in stack if not call.module.startswith("labdaemon.testing")}
    landmarks = dict.fromkeys(stack[-1].function for stack in stacks)
    return CapturePath(tuple(landmarks), tuple(sorted(files)), tuple(sorted(climbs)))


if __name__ == "__main__":
    print(measure())
