from __future__ import annotations

import asyncio
import hashlib
import itertools
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest

from labdaemon.campaign.interlocks import InterlockLimits
from labdaemon.campaign.manual_request import ManualRequest
from labdaemon.campaign.retry import RetryPolicy
from labdaemon.errors import LimitError
from labdaemon.journal import records
from labdaemon.stream.messages import BusyError, NotFoundError, WrongStateError
from labdaemon.testing.lab import FakeLab

THREE = """
name = "three"
[[phase]]
kind = "sharp"
frames = 3
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0, 12.0]
amplitude_mm = [2.0, 1.0, 0.5]
exposure_s = 1.0
on_fault = "{on_fault}"
"""
RETRY = THREE.format(on_fault="retry")


def kinds(lab: FakeLab) -> list[str]:
    return [event.kind for event in lab.journal.events_after(0, 10_000)]


def envelopes(lab: FakeLab) -> list[str]:
    return [event.data["capture"] for event in lab.journal.events_after(0, 10_000) if event.kind == "envelope"]


def test_a_campaign_is_walked_to_its_end(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        record = await lab.until(id)
        assert record.state == "completed"
        told = kinds(lab)
        assert told[0] == "campaign.started"
        assert told[-1] == "campaign.completed"
        assert told.count("capture.completed") == 6
        assert sorted(envelopes(lab)) == ["00001-steps-5.000hz-01", "00002-steps-8.000hz-01", "00003-steps-12.000hz-01"]
        assert "fault" not in told
        assert not lab.world.moves()
        assert [event.seq for event in lab.journal.events_after(0, 1000)] == list(range(1, len(told) + 1))

    simulate(scenario)


def test_what_it_leaves_is_a_data_set_folder(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id)
        folder = lab.data / "campaigns" / id
        assert {path.name for path in folder.iterdir()} == {
            "rig.toml", "control.csv", "campaign.toml", "sharp", "captures", "results",
        }  # fmt: skip
        assert sorted(path.name for path in (folder / "sharp").iterdir()) == sorted(
            f"{camera}{number}.dng" for camera in ("left", "right") for number in ("", "-2", "-3")
        )
        capture = folder / "captures" / "00002-steps-8.000hz-01"
        assert {path.name for path in capture.iterdir()} == {"left.dng", "right.dng", "capture.toml"}
        told = tomllib.loads((capture / "capture.toml").read_text())
        assert (told["frequency_hz"], told["exposure_s"]) == (8.0, 1.0)
        for frame in records.frames(lab.journal, id, capture.name):
            assert hashlib.sha256((lab.data / frame.path).read_bytes()).hexdigest() == frame.sha256
        assert all(not camera.card for camera in lab.fake.cameras)

    simulate(scenario)


def test_the_structure_has_settled_before_the_shutters_open(simulate):
    async def scenario(lab: FakeLab):
        off: list[float] = []

        def look(operation: str) -> None:
            if operation == "trigger.fire" and lab.world.running:
                off.append(lab.world.response_mm() / (lab.world.response_gain * lab.world.amplitude_mm) - 1.0)

        lab.world.on_call = look
        await lab.until(await lab.submit(RETRY))
        assert len(off) == 3
        assert max(abs(value) for value in off) < 0.02

    simulate(scenario)


def test_the_next_step_moves_while_the_last_is_measured(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.measure_s = 60.0
        started: dict[str, float] = {}
        lab.journal.listen(lambda name: started.setdefault(f"{name} {len(started)}", lab.clock.monotonic()))
        await lab.until(await lab.submit(RETRY))
        steps = [at for name, at in started.items() if name.startswith("step.started")]
        first_envelope = next(at for name, at in started.items() if name.startswith("envelope"))
        assert sum(at < first_envelope for at in steps) >= 3

    simulate(scenario)


def test_a_full_queue_makes_the_table_wait_and_drops_nothing(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.measure_s = 300.0
        most = 0

        def look(operation: str) -> None:
            nonlocal most
            most = max(most, lab.engine.queue.waiting)

        lab.world.on_call = look
        toml = RETRY.replace("[5.0, 8.0, 12.0]", "{ start = 4, stop = 14, count = 12 }")
        toml = toml.replace("[2.0, 1.0, 0.5]", "0.5")
        id = await lab.submit(toml)
        assert (await lab.until(id)).state == "completed"
        assert most == 4
        assert len(envelopes(lab)) == 12

    simulate(scenario)


@pytest.mark.parametrize(("on_fault", "state"), [("skip", "completed"), ("pause", "paused"), ("abort", "aborted")])
def test_on_fault_is_obeyed(simulate, on_fault: str, state: str):
    async def scenario(lab: FakeLab):
        id = await lab.submit(THREE.format(on_fault=on_fault))
        lab.world.fail("shaker.set", "gone")
        record = await lab.until(id)
        assert record.state == state
        [fault] = [event for event in lab.journal.events_after(0, 1000) if event.kind == "fault"]
        assert fault.data["device"] == "shaker"
        assert fault.data["action"] == on_fault
        assert not lab.world.moves()
        assert kinds(lab).count("step.skipped") == (on_fault == "skip")

    simulate(scenario)


def test_retries_back_off_and_end_in_a_pause(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        tries: list[float] = []
        lab.world.on_call = lambda operation: tries.append(lab.clock.monotonic()) if operation == "shaker.set" else None
        lab.world.fail("shaker.set", *["gone"] * 10)
        record = await lab.until(id)
        assert record.state == "paused"
        assert "port is gone" in (record.reason or "")
        gaps = [later - earlier for earlier, later in itertools.pairwise(tries)]
        assert len(tries) == lab.policy.max_tries
        assert gaps == sorted(gaps)
        assert gaps[0] >= lab.policy.backoff_s
        lab.world.faults.clear()
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"
        assert len(set(envelopes(lab))) == len(envelopes(lab)) == 3

    simulate(scenario)


@pytest.mark.parametrize("moment_s", [0.3, 3.0, 8.0, 17.3, 19.0, 24.0, 31.0])
def test_pause_and_resume_at_any_moment(simulate, moment_s: float):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        await lab.clock.sleep(moment_s)
        await lab.engine.pause()
        await lab.clock.sleep(30.0)
        assert not lab.world.moves()
        assert lab.engine.context.table.excitation is None
        fired = lab.world.fired
        await lab.clock.sleep(600.0)
        assert lab.world.fired == fired
        assert await lab.engine.resume() == id
        assert (await lab.until(id, "completed")).state == "completed"
        assert len(set(envelopes(lab))) == len(envelopes(lab)) == 3
        told = kinds(lab)
        assert told.count("campaign.paused") == told.count("campaign.resumed") == 1

    simulate(scenario)


@pytest.mark.parametrize("moment_s", [0.3, 8.0, 24.0])
def test_abort_at_any_moment(simulate, moment_s: float):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        second = await lab.submit(RETRY)
        await lab.until(id, "running")
        await lab.clock.sleep(moment_s)
        await lab.engine.abort(id)
        assert (await lab.until(id)).state == "aborted"
        assert (await lab.until(second, "completed")).state == "completed"

    simulate(scenario)


def test_a_paused_campaign_can_be_aborted_and_a_queued_one_too(simulate):
    async def scenario(lab: FakeLab):
        first, second = await lab.submit(RETRY), await lab.submit(RETRY)
        await lab.until(first, "running")
        await lab.engine.pause()
        await lab.engine.abort(second)
        assert (await lab.until(second)).state == "aborted"
        await lab.engine.abort()
        assert (await lab.until(first, "aborted")).state == "aborted"
        with pytest.raises(WrongStateError, match="aborted, not running"):
            await lab.engine.abort(second)

    simulate(scenario)


def test_commands_in_the_wrong_state_say_so(simulate):
    async def scenario(lab: FakeLab):
        with pytest.raises(NotFoundError, match="no campaign is in progress"):
            await lab.engine.pause()
        with pytest.raises(NotFoundError, match="no campaign 'x'"):
            await lab.engine.abort("x")
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        with pytest.raises(WrongStateError, match="is running, not paused"):
            await lab.engine.resume()
        with pytest.raises(BusyError, match="pause it first"):
            await lab.engine.capture("now")
        await lab.engine.pause()
        with pytest.raises(WrongStateError, match="is paused, not running"):
            await lab.engine.pause()

    simulate(scenario)


def test_stop_works_in_every_state_and_pauses_what_runs(simulate):
    async def scenario(lab: FakeLab):
        assert (await lab.engine.stop()).by == "soft"
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        while not lab.world.moves():
            await lab.clock.sleep(0.5)
        before = lab.clock.monotonic()
        assert (await lab.engine.stop()).by == "soft"
        assert min(at for at in lab.world.stopped_at if at >= before) - before <= 0.1
        assert not lab.world.moves()
        assert (await lab.until(id)).state == "paused"
        assert (await lab.engine.stop()).by == "soft"
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"

    simulate(scenario)


def test_stop_goes_on_to_the_hard_way_and_the_enable_line(simulate):
    async def scenario(lab: FakeLab):
        lab.world.fail("shaker.stop", "gone")
        assert (await lab.engine.stop()).by == "hard"
        lab.world.fail("shaker.stop", "silent")
        lab.world.fail("shaker.stop_now", "rubbish")
        rest = await lab.engine.stop()
        assert rest.by == "enable"
        assert len(rest.troubles) == 2

    simulate(scenario)


def test_a_capture_in_flight_when_paused_is_seen_to_its_end(simulate):
    async def scenario(lab: FakeLab):
        fired = asyncio.Event()
        lab.journal.listen(lambda name: fired.set() if name == "capture.fired" and lab.world.running else None)
        id = await lab.submit(RETRY)
        await fired.wait()
        await lab.engine.pause()
        await lab.clock.sleep(60.0)
        assert records.captures(lab.journal, id, "discarded") == []
        assert [capture.step for capture in records.captures(lab.journal, id, "measured")] == [1]

    simulate(scenario)


def test_a_capture_in_flight_when_stopped_is_given_up_and_repeated(simulate):
    async def scenario(lab: FakeLab):
        fired = asyncio.Event()
        lab.journal.listen(lambda name: fired.set() if name == "capture.fired" and lab.world.running else None)
        id = await lab.submit(RETRY)
        await fired.wait()
        await lab.engine.stop()
        await lab.clock.sleep(10.0)
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"
        [lost] = records.captures(lab.journal, id, "discarded")
        assert lost.name == "00001-steps-5.000hz-01"
        assert "00001-steps-5.000hz-01-r2" in envelopes(lab)
        assert all(frame.state == "set_aside" for frame in records.frames(lab.journal, id, lost.name))

    simulate(scenario)


def test_too_large_a_response_stops_the_table_within_a_tenth_of_a_second_of_being_seen(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        crossed: list[float] = []

        def look(operation: str) -> None:
            if operation == "response.read" and lab.world.response_mm() > 4.0 and not crossed:
                crossed.append(lab.clock.monotonic())

        lab.world.on_call = look
        record = await lab.until(id)
        assert record.state == "paused"
        assert "max_response_mm" in (record.reason or "")
        assert lab.world.stopped_at[0] - crossed[0] <= 0.1
        assert not lab.world.moves()

    simulate(scenario, limits=InterlockLimits(max_response_mm=4.0))


def test_a_response_that_grows_too_fast_stops_the_table(simulate):
    async def scenario(lab: FakeLab):
        record = await lab.until(await lab.submit(RETRY))
        assert record.state == "paused"
        assert "max_response_rate_mm_s" in (record.reason or "")

    simulate(scenario, limits=InterlockLimits(max_response_rate_mm_s=0.5))


def test_gauges_that_disagree_stop_the_table(simulate):
    async def scenario(lab: FakeLab):
        lab.fake.gauges[0].gain = 1.5
        record = await lab.until(await lab.submit(RETRY))
        assert record.state == "paused"
        assert "table gauge reads" in (record.reason or "")
        assert not lab.world.moves()

    simulate(scenario)


def test_blur_at_the_papers_edge_stops_the_table(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.flags = ("paper_edge",)
        record = await lab.until(await lab.submit(RETRY))
        assert record.state == "paused"
        assert "edge of its paper" in (record.reason or "")

    simulate(scenario)


def test_an_envelope_that_comes_when_the_table_rests_holds_the_campaign_and_the_next_one(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.measure_s, lab.measurer.amplitude_mm = 100.0, 7.0
        id = await lab.submit(RETRY.replace("[5.0, 8.0, 12.0]", "[5.0]").replace("[2.0, 1.0, 0.5]", "1.0"))
        following = await lab.submit(RETRY)
        record = await lab.until(id)
        assert record.state == "paused"
        assert "max_response_mm = 5" in (record.reason or "")
        [fault] = [event for event in lab.journal.events_after(0, 1000) if event.kind == "fault"]
        assert "moves 7 mm" in fault.data["message"]
        await lab.clock.sleep(600.0)
        assert (records.campaign(lab.journal, following) or record).state == "queued"
        await lab.engine.resume()
        assert (await lab.until(id, "completed", "paused")).state == "completed"
        await lab.engine.abort(following)

    simulate(scenario, limits=InterlockLimits(max_response_mm=5.0))


@pytest.mark.parametrize(("attribute", "value"), [("battery_percent", 3), ("free_bytes", 1000)])
def test_an_empty_battery_and_a_full_card_stop_the_table(simulate, attribute: str, value: int):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY.replace("exposure_s", "captures = 100\nexposure_s"))
        while not lab.world.moves():
            await lab.clock.sleep(1.0)
        setattr(lab.fake.cameras[1], attribute, value)
        record = await lab.until(id)
        assert record.state == "paused"
        assert "right" in (record.reason or "")
        assert not lab.world.moves()

    simulate(scenario)


def test_workers_that_stall_stop_the_table(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.measure_s = 1e5
        record = await lab.until(await lab.submit(RETRY.replace("exposure_s", "captures = 100\nexposure_s")))
        assert record.state == "paused"
        assert "waited" in (record.reason or "")

    simulate(scenario)


def test_a_dropped_enable_line_is_noticed(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        while not lab.world.moves():
            await lab.clock.sleep(0.5)
        lab.world.enabled = False
        record = await lab.until(id)
        assert record.state == "paused"
        assert "enable line" in (record.reason or "")
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"

    simulate(scenario)


def test_without_a_heartbeat_the_table_comes_to_rest(simulate):
    async def scenario(lab: FakeLab):
        await lab.submit(RETRY)
        while not lab.world.moves():
            await lab.clock.sleep(0.5)
        await lab.kill()
        await lab.clock.sleep(2.0)
        assert lab.world.running
        assert not lab.world.moves()
        lab.start()

    simulate(scenario)


def test_a_frame_that_cannot_be_measured_is_kept_and_reported(simulate):
    async def scenario(lab: FakeLab):
        lab.measurer.unmeasurable.add("00002-steps-8.000hz-01")
        id = await lab.submit(RETRY)
        assert (await lab.until(id)).state == "completed"
        assert len(envelopes(lab)) == 2
        [fault] = [event for event in lab.journal.events_after(0, 1000) if event.kind == "fault"]
        assert fault.data["capture"] == "00002-steps-8.000hz-01"
        assert (lab.data / "campaigns" / id / "captures" / "00002-steps-8.000hz-01" / "left.dng").exists()

    simulate(scenario)


def test_a_lost_frame_is_retried_and_its_companion_set_aside(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        while not records.captures(lab.journal, id, "stored"):
            await lab.clock.sleep(0.1)  # from then on the body's clock is known, and says whose a file is
        lab.world.fail("right.release", "lost_file")
        assert (await lab.until(id)).state == "completed"
        [lost] = records.captures(lab.journal, id, "discarded")
        assert [frame.camera for frame in records.frames(lab.journal, id, lost.name)] == ["left"]
        made = {digest for camera in lab.fake.cameras for digest in camera.made}
        kept = {hashlib.sha256(path.read_bytes()).hexdigest() for path in lab.data.rglob("*.[dD][nN][gG]")}
        assert made == kept

    simulate(scenario)


def test_an_unexpected_file_is_not_taken_for_a_frame(simulate):
    async def scenario(lab: FakeLab):
        await lab.clock.sleep(5.0)
        lab.fake.cameras[0].release(0.5)
        await lab.clock.sleep(60.0)
        id = await lab.submit(RETRY)
        assert (await lab.until(id)).state == "completed"
        assert [path.name for path in (lab.data / "set_aside" / "unexpected").iterdir()] == ["left-DSC_00001.DNG"]
        assert len(envelopes(lab)) == 3

    simulate(scenario)


def test_files_that_were_on_the_card_before_are_left_alone(simulate, tmp_path: Path):
    async def scenario(lab: FakeLab):
        await lab.kill()
        lab.fake.cameras[0].release(0.5)
        lab.fake.cameras[0].arriving.clear()
        lab.start()
        id = await lab.submit(RETRY)
        assert (await lab.until(id)).state == "completed"
        assert [file.name for file, _ in lab.fake.cameras[0].card.values()] == ["DSC_00001.DNG"]

    simulate(scenario)


def test_a_full_disk_pauses_and_goes_on_by_itself(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        while not lab.world.moves():
            await lab.clock.sleep(0.5)
        pages = lab.journal._writer.execute("PRAGMA page_count").fetchone()[0]
        lab.journal._writer.execute(f"PRAGMA max_page_count = {pages}")
        await lab.clock.sleep(1800.0)
        assert not lab.world.moves()
        assert records.campaign(lab.journal, id).state == "running"
        lab.journal._writer.execute("PRAGMA max_page_count = 100000")
        assert (await lab.until(id)).state == "completed"
        assert len(set(envelopes(lab))) == len(envelopes(lab)) == 3

    simulate(scenario)


def test_a_campaign_planned_for_another_rig_is_not_gone_on_with_unless_told(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        await lab.kill()
        lab.rig_digest = "changed"
        lab.start()
        record = await lab.until(id)
        assert record.state == "paused"
        assert "rig file has changed" in (record.reason or "")
        with pytest.raises(WrongStateError, match="--accept-changed-rig"):
            await lab.engine.resume()
        await lab.engine.resume(accept_changed_rig=True)
        assert (await lab.until(id, "completed")).state == "completed"

    simulate(scenario)


def test_a_paused_campaign_stays_paused_over_a_restart(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        await lab.engine.pause()
        await lab.kill()
        lab.start()
        await lab.clock.sleep(600.0)
        assert records.campaign(lab.journal, id).state == "paused"
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"

    simulate(scenario)


def test_clock_jumps_disturb_nothing(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(RETRY)
        await lab.until(id, "running")
        await lab.clock.sleep(20.0)
        lab.clock.jump(-7200.0)
        await lab.clock.sleep(20.0)
        lab.clock.jump(36000.0)
        assert (await lab.until(id)).state == "completed"
        assert len(envelopes(lab)) == 3

    simulate(scenario)


def test_a_request_sent_again_queues_nothing_twice(simulate):
    async def scenario(lab: FakeLab):
        plan = lab.plan(RETRY)
        first = await lab.engine.submit(plan, "r-1")
        assert await lab.engine.submit(plan, "r-1") == first
        assert await lab.engine.submit(plan, "r-2") != first
        assert len(records.campaigns(lab.journal)) == 2

    simulate(scenario)


def test_beyond_the_limits_nothing_is_queued(simulate):
    async def scenario(lab: FakeLab):
        with pytest.raises(LimitError, match="amplitude_mm"):
            await lab.submit(RETRY.replace("[2.0, 1.0, 0.5]", "[200.0, 1.0, 0.5]"))
        assert records.campaigns(lab.journal) == []

    simulate(scenario)


PHASES = """
name = "phases"
[[phase]]
kind = "sharp"
frames = 2
every_steps = 2
[[phase]]
kind = "sweep"
frequency_hz = { start = 5, stop = 8, count = 4, spacing = "log" }
amplitude_mm = 1.0
both_directions = true
exposure_s = 1.0
[[phase]]
kind = "dwell"
frequency_hz = 6.0
amplitude_mm = 1.0
hold_s = 300
exposure_s = 1.0
[[phase]]
kind = "pause"
duration_s = 100
[[phase]]
kind = "steps"
frequency_hz = [5.3]
amplitude_mm = 1.0
exposure_s = 1.0
phase_rad = [0.0, 1.5708]
[[phase]]
kind = "pause"
"""


def test_all_kinds_of_phases_are_walked(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(PHASES)
        record = await lab.until(id)
        assert record.state == "paused"
        assert "waits for a person" in (record.reason or "")
        await lab.engine.resume()
        assert (await lab.until(id, "completed")).state == "completed"
        folder = lab.data / "campaigns" / id
        assert (folder / "sharp" / "set-002" / "left.dng").exists()
        told = envelopes(lab)
        groups = [name for name in told if name.startswith("0") and "5.300hz" in name and "-0" not in name[-3:]]
        assert len(groups) == 1
        assert sum("dwell" in name for name in told) == 1
        assert sum("sweep" in name for name in told) >= 7
        [last] = [c for c in records.captures(lab.journal, id, "measured") if c.grouped and c.shot == 1]
        told = tomllib.loads((folder / "captures" / last.name / "capture.toml").read_text())
        assert told["group"] == last.grouped
        assert told["phase_rad"] == pytest.approx(1.5708)
        assert told["cameras"]["left"]["phase_rad"] < told["cameras"]["right"]["phase_rad"]
        assert told["sharp"].startswith("set-")

    simulate(scenario)


EXTERNAL = """
name = "external"
[[phase]]
kind = "sharp"
frames = 2
[[phase]]
kind = "external"
captures = 3
wait_s = 3600
exposure_s = 1.0
on_fault = "{on_fault}"
"""


def test_the_papers_own_wiring_files_that_arrive_are_captures(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(EXTERNAL.format(on_fault="pause"))
        for _ in range(5):
            await lab.clock.sleep(30.0)
            for camera in lab.fake.cameras:
                camera.release(1.0)
        assert (await lab.until(id)).state == "completed"
        assert len(envelopes(lab)) == 3
        [capture, *_] = records.captures(lab.journal, id, "measured")
        assert capture.frequency_hz is None

    simulate(scenario, has_trigger=False)


def test_phases_that_an_outside_system_states_are_its_captures_and_group_them(simulate):
    async def scenario(lab: FakeLab):
        stated = "exposure_s = 1.0\nfrequency_hz = 7.0\namplitude_mm = 0.5\nphase_rad = [0.0, 1.5]\n"
        toml = (
            EXTERNAL.format(on_fault="pause")
            .replace("captures = 3", "captures = 1")
            .replace("exposure_s = 1.0\n", stated)
        )
        id = await lab.submit(toml)
        while lab.engine.step is None or lab.engine.step.kind != "external":
            await lab.clock.sleep(1.0)
        for _ in range(2):
            await lab.clock.sleep(30.0)
            lab.fake.trigger.edge(1.0)
        assert (await lab.until(id)).state == "completed"
        captures = records.captures(lab.journal, id, "measured")
        assert [(one.frequency_hz, one.amplitude_mm, one.phase_rad) for one in captures] == [
            (7.0, 0.5, 0.0),
            (7.0, 0.5, 1.5),
        ]
        assert len({one.grouped for one in captures}) == 1
        assert len(envelopes(lab)) == 1

    simulate(scenario)


def test_an_outside_system_fires_through_the_box_which_sees_the_phase(simulate):
    async def scenario(lab: FakeLab):
        toml = EXTERNAL.format(on_fault="pause").replace("exposure_s = 1.0", "exposure_s = 1.0\nfrequency_hz = 7.0", 1)
        id = await lab.submit(toml)
        while lab.engine.step is None or lab.engine.step.kind != "external":
            await lab.clock.sleep(1.0)
        for _ in range(3):
            await lab.clock.sleep(30.0)
            lab.fake.trigger.edge(1.0)
        assert (await lab.until(id)).state == "completed"
        captures = records.captures(lab.journal, id, "measured")
        assert [(capture.frequency_hz, capture.phase_rad) for capture in captures] == [(7.0, 0.5)] * 3

    simulate(scenario)


def test_outside_releases_that_do_not_come_are_a_fault(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(EXTERNAL.format(on_fault="abort"))
        record = await lab.until(id)
        assert record.state == "aborted"
        assert "3 of 3 outside releases did not come within 3600 s" in (record.reason or "")

    simulate(scenario)


def test_without_a_shaker_the_daemon_keeps_what_others_fire_and_sets_a_lone_frame_aside(simulate):
    async def scenario(lab: FakeLab):
        await lab.clock.sleep(5.0)
        lab.fake.cameras[0].release(1.0)
        await lab.clock.sleep(30.0)
        for camera in lab.fake.cameras:
            camera.release(1.0)
        await lab.clock.sleep(30.0)
        [capture] = records.captures(lab.journal, "0000-manual", "stored", "measured", "unmeasured")
        assert set(capture.files) == {"left", "right"}
        assert len(list((lab.data / "campaigns" / "0000-manual" / "set_aside").rglob("left-*"))) == 1

    simulate(scenario, has_trigger=False)


def test_a_manual_capture_answers_once_fired_and_is_measured_against_the_last_sharp_set(simulate):
    async def scenario(lab: FakeLab):
        sharp = await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        await lab.clock.sleep(10.0)
        before = lab.clock.monotonic()
        taken = await lab.engine.capture(ManualRequest("first", request_id="q"))
        assert lab.clock.monotonic() - before < 1.0
        assert taken.opened_at is not None
        assert records.reply_to(lab.journal, "q") == ("capture", {"capture": taken.name, "opened_at": taken.opened_at})
        await lab.clock.sleep(30.0)
        assert sharp.is_sharp
        assert envelopes(lab) == [taken.name]

    simulate(scenario)


@pytest.mark.parametrize("on_fault", ["retry", "skip", "abort"])
def test_frames_of_another_size_hold_the_campaign_at_the_first_of_them(simulate, on_fault: str):
    async def scenario(lab: FakeLab):
        lab.measurer.wrong_size = "camera left delivers 64x48 pixels, but image_size says 60x40"
        id = await lab.submit(THREE.format(on_fault=on_fault))
        record = await lab.until(id)
        assert record.state == "paused"
        assert "image_size says 60x40" in (record.reason or "")
        assert kinds(lab).count("capture.completed") == 1
        assert kinds(lab).count("fault") == 1
        assert not lab.world.stopped_at or lab.world.amplitude_mm == 0.0  # nothing ever moved
        assert len(list((lab.data / "campaigns" / id / "set_aside").rglob("*.DNG"))) == 2
        lab.measurer.wrong_size = ""  # a person has mended the body's setting
        await lab.engine.resume()
        assert (await lab.until(id, "completed", "paused")).state == "completed"
        assert len(envelopes(lab)) == 3
        assert len(list((lab.data / "campaigns" / id / "sharp").glob("*.dng"))) == 6

    simulate(scenario)


def test_a_step_waits_for_its_hours(simulate):
    async def scenario(lab: FakeLab):
        toml = RETRY.replace("on_fault", 'not_before = "02:00"\nnot_after = "05:00"\non_fault')
        id = await lab.submit(toml)
        assert (await lab.until(id)).state == "completed"
        first = next(event for event in lab.journal.events_after(0, 1000) if event.data.get("kind") == "steps")
        hour = datetime.fromisoformat(first.at).astimezone().hour
        assert 2 <= hour < 5
        assert datetime.fromisoformat(first.at) > datetime(2026, 5, 4, 18, tzinfo=UTC)

    simulate(scenario)


def test_a_lost_camera_comes_back(simulate):
    async def scenario(lab: FakeLab):
        lab.world.fail("right.wait_file", *["gone"] * 3)
        lab.world.fail("right.files", *["gone"] * 2)
        id = await lab.submit(RETRY)
        assert (await lab.until(id)).state == "completed"
        assert len(envelopes(lab)) == 3

    simulate(scenario, policy=RetryPolicy(max_tries=6))
