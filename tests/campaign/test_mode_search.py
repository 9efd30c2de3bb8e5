"""Closed-loop sweeps in simulated time: a structure of two modes, known to the measurer alone."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labdaemon.campaign.measurement_queue import CaptureRows
from labdaemon.campaign.mode_search import decide_step
from labdaemon.campaign.open_steps import with_decisions
from labdaemon.capture.abilities import GaugeRecord
from labdaemon.clock import SimulatedClock
from labdaemon.errors import ConfigError, InterlockError
from labdaemon.events import DecisionData
from labdaemon.journal import records
from labdaemon.journal.decision_records import decisions_of
from labdaemon.testing.gauge import FakeGauge
from labdaemon.testing.lab import FakeLab, FakeMeasurer

NATURAL_HZ = np.array([6.12, 9.31])
DAMPING = np.array([0.014, 0.011])
RESIDUES = np.array([[0.5, -0.3, 0.1], [0.9, 0.2, -0.1], [1.2, 0.7, 0.2], [1.3, -0.9, 0.05]])
"""(targets, modes and one more: along Y) motion along X of each mode, and along Y of the first."""
SD_MM = 0.003

CAMPAIGN = """
name = "search"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "resonance"
band_hz = [5.0, 11.0]
amplitude_mm = 0.5
largest_mm = 5.0
phase_rad = [0.0, 1.5708]
sd_frequency = {sd_frequency}
sd_damping = {sd_damping}
most_steps = {most_steps}
"""
QUICK = CAMPAIGN.format(sd_frequency=8e-6, sd_damping=0.002, most_steps=40)


def response_mm(frequency_hz: float, table_mm: float) -> np.ndarray:
    """(targets, 3) complex motion."""
    mode = frequency_hz**2 / (NATURAL_HZ**2 - frequency_hz**2 + 2j * DAMPING * NATURAL_HZ * frequency_hz)
    motion = np.zeros((len(RESIDUES), 3), complex)
    motion[:, 0] = 1.0 + RESIDUES[:, :2] @ mode
    motion[:, 1] = RESIDUES[:, 2] * mode[0]
    return table_mm * motion


@dataclass(slots=True)
class ResonantMeasurer(FakeMeasurer):
    """Envelopes of a structure that resonates, with phase and noise; the noise depends on the excitation alone."""

    seed: int = 1

    async def measure(self, folder: Path, sharp: str | None, captures: Sequence[str], name: str) -> CaptureRows:
        measured = await FakeMeasurer.measure(self, folder, sharp, captures, name)
        about = tomllib.loads((folder / "captures" / captures[-1] / "capture.toml").read_text())
        frequency_hz, table_mm = about["frequency_hz"], about["excitation_amplitude_mm"]
        rng = np.random.default_rng([self.seed, round(1000 * frequency_hz)])
        turn = np.exp(1j * about["gauges"]["table"]["phase_rad"])  # the structure moves with its table
        motion = response_mm(frequency_hz, table_mm) * turn
        motion = motion + SD_MM * (rng.normal(size=motion.shape) + 1j * rng.normal(size=motion.shape))
        return CaptureRows([self._row(name, k, motion[k]) for k in range(len(motion))], measured.measurements)

    def _row(self, capture: str, place: int, motion: np.ndarray) -> dict[str, Any]:
        row: dict[str, Any] = {"capture": capture, "target": f"T{place}", "flags": list(self.flags)}
        for axis, value in zip("xyz", motion, strict=True):
            row |= {f"{axis}_mm": 0.0, f"a{axis}_mm": value.real, f"b{axis}_mm": value.imag}
            row |= {f"sd_{axis}_mm": 0.01, f"sd_a{axis}_mm": SD_MM, f"sd_b{axis}_mm": SD_MM}
        return row


async def run_to_end(lab: FakeLab, toml: str) -> str:
    lab.measurer = ResonantMeasurer()
    lab.engine.queue._measurer = lab.measurer
    id = await lab.submit(toml)
    record = await lab.until(id)
    assert record.state == "completed", record.reason
    return id


def test_modes_of_an_unknown_structure_are_found(simulate):
    async def scenario(lab: FakeLab):
        largest = 0.0

        def look(operation: str) -> None:
            nonlocal largest
            if operation == "trigger.fire" and lab.world.running:
                moved = np.linalg.norm(response_mm(lab.world.frequency_hz, lab.world.amplitude_mm), axis=1).max()
                if lab.world.frequency_hz not in first:
                    largest = max(largest, float(moved))

        plan = lab.plan(QUICK)
        first = {step.frequency_hz for step in plan.steps if step.frequency_hz is not None}
        lab.world.on_call = look
        id = await run_to_end(lab, QUICK)
        decisions = list(decisions_of(lab.journal, id).values())
        end = decisions[-1]
        assert end.is_reached
        assert end.frequency_hz is None
        assert [one.is_reached for one in decisions[:-1]] == [None] * (len(decisions) - 1)
        assert len(end.modes) == len(NATURAL_HZ)
        for mode, natural, damping in zip(end.modes, NATURAL_HZ, DAMPING, strict=True):
            assert 0 < mode.sd_frequency_hz <= 8e-6 * natural
            assert abs(mode.frequency_hz - natural) < 4 * mode.sd_frequency_hz
            assert abs(mode.damping - damping) < 4 * mode.sd_damping
        taken = records.captures_by_step(lab.journal, id)
        assert len(taken) - 1 == end.measured == len(first) + len(decisions) - 1 < 40
        assert not end.pending, "what ends a search waits for all envelopes"
        assert 0 < largest < 5.5, "the model keeps the motion near what was asked for"
        events = [event for event in lab.journal.events_after(0, 10_000) if event.kind == "step.decided"]
        assert [DecisionData.model_validate(event.data) for event in events] == decisions
        envelopes = [event.data for event in lab.journal.events_after(0, 10_000) if event.kind == "envelope"]
        assert len(envelopes) == end.measured, "each group is measured once, jointly"
        assert not lab.world.moves()

    simulate(scenario)


def check_decisions(lab: FakeLab, id: str) -> None:
    """Each decision follows again from the journal as it was then, to the last digit."""
    plan, decisions = lab.plan(QUICK), decisions_of(lab.journal, id)
    as_decided = with_decisions(plan, decisions)
    for index, decision in decisions.items():
        assert decide_step(lab.journal, id, as_decided, plan.steps[index], decision.pending) == decision


@pytest.mark.parametrize("transition", ["before step.decided", "step.decided", "envelope"])
def test_a_killed_search_goes_on_with_the_same_decisions(tmp_path: Path, transition: str):
    class Killed(BaseException):
        pass

    clock = SimulatedClock()

    async def main() -> int:
        lab = FakeLab(tmp_path, clock)
        lab.measurer = ResonantMeasurer()
        kept: list[dict[int, DecisionData]] = []
        seen = 0

        def listen(name: str) -> None:
            nonlocal seen
            seen += name == transition and ("decided" in name or bool(decisions_of(lab.journal, id)))
            if name == transition and seen == 1 + 2 * len(kept) and len(kept) < 2:
                kept.append(decisions_of(lab.journal, id))
                raise Killed

        lab.start()
        id = await lab.submit(QUICK)
        lab.journal.listen(listen)
        while True:
            try:
                record = await lab.until(id)
                break
            except Killed:
                await lab.kill()
                lab.start()
                lab.journal.listen(listen)
        assert record.state == "completed"
        decisions = decisions_of(lab.journal, id)
        assert decisions[max(decisions)].is_reached
        for before in kept:
            assert {index: decisions[index] for index in before} == before
        check_decisions(lab, id)
        taken = records.captures_by_step(lab.journal, id)
        assert set(taken.values()) == {1, 2}, "no shot was taken twice"
        await lab.kill()
        return len(kept)

    assert clock.run(main()) == 2


PEAKS = """
[[phase]]
kind = "dwell"
at = "peaks"
amplitude_mm = 0.05
hold_s = 5.0
phase_rad = [0.0, 1.5708]
most_peaks = {most}
"""


@pytest.mark.parametrize("most", [1, 5])
def test_a_later_dwell_visits_each_mode(simulate, most: int):
    async def scenario(lab: FakeLab):
        easy = CAMPAIGN.format(sd_frequency=1e-3, sd_damping=0.1, most_steps=30) + PEAKS.format(most=most)
        id = await run_to_end(lab, easy)
        decisions = list(decisions_of(lab.journal, id).values())
        found = next(one for one in decisions if one.search == 0 and one.frequency_hz is None)
        visited = [one for one in decisions if one.search == 1]
        expected = [round(mode.frequency_hz, 3) for mode in found.modes][:most]
        assert [one.frequency_hz for one in visited] == [*expected, None]
        assert visited[-1].is_reached is (most >= len(found.modes) == 2)
        labels = {event.data["capture"] for event in lab.journal.events_after(0, 10_000) if event.kind == "envelope"}
        assert sum("dwell" in label for label in labels) == len(expected)

    simulate(scenario)


SWEEP = """
name = "sweep"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "sweep"
frequency_hz = { start = 5.0, stop = 11.0, count = 25, spacing = "log" }
amplitude_mm = 0.2
phase_rad = [0.0, 1.5708]
"""


@pytest.mark.parametrize("has_gauge", [True, False])
def test_a_dwell_visits_the_peaks_of_a_sweep(simulate, monkeypatch: pytest.MonkeyPatch, has_gauge: bool):
    """From the gauge on the structure, which sees what the third target does; without one from the envelopes."""

    def record(gauge: FakeGauge, *, start_s: float, duration_s: float) -> GaugeRecord:
        world = gauge.world
        moved = complex(world.amplitude_mm)
        if gauge.role == "response":
            moved = response_mm(world.frequency_hz, world.amplitude_mm)[2, 0] * has_gauge
        t_s = np.arange(200) * duration_s / 200
        angle = 2 * np.pi * world.frequency_hz * (t_s + start_s)
        value = moved.real * np.sin(angle) + moved.imag * np.cos(angle) + 1e-4 * np.sin(1e3 * np.arange(200) ** 2)
        return GaugeRecord(t_s, value, 1e-3)

    monkeypatch.setattr(FakeGauge, "record", record)

    async def scenario(lab: FakeLab):
        id = await run_to_end(lab, SWEEP + PEAKS.format(most=5))
        decisions = decisions_of(lab.journal, id)
        found = next(one for one in decisions.values() if one.search == 0)
        assert found.is_reached
        assert found.frequency_hz is None
        assert ("gauge" if has_gauge else "envelopes") in found.reason
        assert [one.frequency_hz for one in found.modes] == pytest.approx(list(NATURAL_HZ), rel=2e-3)
        visited = [one.frequency_hz for one in decisions.values() if one.search == 1]
        assert visited == [*(round(one.frequency_hz, 3) for one in found.modes), None]
        plan = lab.plan(SWEEP + PEAKS.format(most=5))
        assert decide_step(lab.journal, id, with_decisions(plan, decisions), plan.steps[found.step]) == found

    simulate(scenario)


def test_a_sweep_without_peaks_is_said_and_nothing_is_visited(simulate):
    async def scenario(lab: FakeLab):
        few = SWEEP.replace("count = 25", "count = 3")
        id = await run_to_end(lab, few + PEAKS.format(most=5))
        ends = list(decisions_of(lab.journal, id).values())
        assert [one.is_reached for one in ends] == [False, False]
        assert "at least 5 frequencies" in ends[0].reason
        assert "found no mode" in ends[1].reason

    simulate(scenario)


def test_only_a_sweep_that_peaks_follow_ends_in_a_search(simulate):
    async def scenario(lab: FakeLab):
        assert not lab.plan(SWEEP).searches
        both = SWEEP + SWEEP.partition("frames = 1")[2] + PEAKS.format(most=2)
        assert [one.sweep for one in lab.plan(both).searches] == [2, None]

    simulate(scenario)


@pytest.mark.parametrize(
    ("phases", "words"),
    [
        (PEAKS.format(most=2), "phase[0].at"),
        (QUICK.partition("[[phase]]")[2] + PEAKS.format(most=0), "most_peaks"),
        (PEAKS.format(most=2) + "frequency_hz = 5.0\n", "either frequency_hz or at"),
        (PEAKS.format(most=2).replace('at = "peaks"\nam', "am"), "either frequency_hz or at"),
        (PEAKS.format(most=2) + "captures = 2\n", "one group of captures"),
    ],
)
def test_mistakes_about_peaks_are_refused(simulate, phases: str, words: str):
    async def scenario(lab: FakeLab):
        head = 'name = "peaks"\n' + ("[[phase]]" if phases.startswith("\nkind") else "")
        with pytest.raises(ConfigError) as refused:
            lab.plan(head + phases)
        assert words in str(refused.value)

    simulate(scenario)


def test_a_search_says_why_it_ended_early(simulate):
    async def scenario(lab: FakeLab):
        few = CAMPAIGN.format(sd_frequency=1e-7, sd_damping=0.0001, most_steps=16)
        id = await run_to_end(lab, few)
        end = list(decisions_of(lab.journal, id).values())[-1]
        assert end.is_reached is False
        assert end.reason.startswith("16 steps are as many as were allowed")
        assert len(end.modes) == 2
        assert end.measured == 16

    simulate(scenario)


def test_flagged_targets_end_a_search_with_the_reason(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer = ResonantMeasurer(flags=("occluded",))
        lab.engine.queue._measurer = lab.measurer
        id = await lab.submit(QUICK)
        assert (await lab.until(id)).state == "completed"
        (end,) = decisions_of(lab.journal, id).values()
        assert (end.is_reached, end.modes) == (False, ())
        assert "without a flag" in end.reason

    simulate(scenario)


def test_an_interlock_while_a_step_is_chosen_stops_the_table(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer = ResonantMeasurer(measure_s=30.0)
        lab.engine.queue._measurer = lab.measurer
        id = await lab.submit(QUICK)
        while lab.engine.step_runner.activity != "choosing the next step":
            await lab.clock.sleep(0.5)
        assert lab.world.moves()
        lab.engine.trip(InterlockError("the structure moves too far"))
        assert (await lab.until(id)).state == "paused"
        assert not lab.world.moves()
        assert not decisions_of(lab.journal, id)
        await lab.engine.resume(id)
        assert (await lab.until(id)).state == "completed"
        assert list(decisions_of(lab.journal, id).values())[-1].is_reached

    simulate(scenario)


def test_a_plan_follows_from_the_file_and_the_decisions(simulate):
    async def scenario(lab: FakeLab):
        plan = lab.plan(QUICK)
        first = [step for step in plan.steps if step.search == 0 and not step.is_open]
        opened = [step for step in plan.steps if step.is_open]
        assert len(first) + len(opened) == 41, "the last one only ends the search"
        decided = DecisionData(step=opened[0].index, search=0, frequency_hz=6.0, amplitude_mm=0.2, hold_s=3.0)
        end = DecisionData(step=opened[1].index, search=0, reason="known")
        made = with_decisions(plan, {decided.step: decided, end.step: end})
        assert [step.index for step in made.steps] == list(range(opened[0].index + 1))
        last = made.steps[-1]
        assert (last.frequency_hz, last.amplitude_mm, last.hold_s, last.grouped) == (6.0, 0.2, 3.0, True)
        assert last.label == f"{last.index:05d}-resonance-6.000hz"

    simulate(scenario)


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ("band_hz = [5.0, 5.1]", "band_hz", "5 % above"),
        ("band_hz = [5.0]", "band_hz", ""),
        ("band_hz = [0.2, 2.0]", "band_hz", "0.5 to 50 Hz"),
        ("amplitude_mm = 0.0", "amplitude_mm", "greater than 0"),
        ("amplitude_mm = 80.0", "amplitude_mm", "acceleration"),
        ("most_steps = 9", "most_steps", "first sweep"),
        ("sd_frequency = 0.0", "sd_frequency", ""),
        ("sd_damping = 2", "sd_damping", ""),
        ("captures = 2", "", "the search chooses what to repeat"),
        ("both_directions = true", "", "the search chooses what to repeat"),
        ("frequency_hz = 5.0", "frequency_hz", ""),
    ],
)
def test_mistakes_are_refused_by_their_key(simulate, change: str, key: str, words: str):
    async def scenario(lab: FakeLab):
        name = change.partition(" =")[0]
        lines = [line for line in QUICK.splitlines() if not line.startswith(f"{name} =")]
        with pytest.raises(ConfigError) as refused:
            lab.plan("\n".join([*lines, change]))
        assert f"phase[1]{'.' if key else ''}{key}" in str(refused.value)
        assert words in str(refused.value)

    simulate(scenario)


def test_no_sharp_set_interrupts_a_search(simulate):
    async def scenario(lab: FakeLab):
        campaign = QUICK.replace("frames = 1", "frames = 1\nevery_steps = 5") + (
            '[[phase]]\nkind = "dwell"\nfrequency_hz = 6.0\namplitude_mm = 0.2\nhold_s = 1.0\n'
        )
        kinds = [step.kind for step in lab.plan(campaign).steps]
        assert kinds == ["sharp", *["resonance"] * 41, "sharp", "dwell"]

    simulate(scenario)
