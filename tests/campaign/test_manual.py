"""Captures outside a campaign: named, described, measured, grouped, and nothing said twice. In simulated time."""

from __future__ import annotations

import asyncio
import tomllib
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.manual_request import ManualRequest, capture_name, is_group_name, safe_name
from labdaemon.campaign.table_motion import TableMotion, contradiction
from labdaemon.clock import SimulatedClock
from labdaemon.journal import records
from labdaemon.stream.messages import InvalidParamsError
from labdaemon.testing.lab import FakeLab
from labdaemon.testing.rig import fake_rig

MANUAL = "0000-manual"


def events(lab: FakeLab, kind: str) -> list[dict[str, Any]]:
    return [event.data for event in lab.journal.events_after(0, 10_000) if event.kind == kind]


def capture_file(lab: FakeLab, name: str) -> dict[str, Any]:
    return tomllib.loads((lab.data / "campaigns" / MANUAL / "captures" / name / "capture.toml").read_text())


async def fire_outside(lab: FakeLab) -> None:
    for camera in lab.fake.cameras:
        camera.release(1.0)
    await lab.clock.sleep(15.0)


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("crack-7", "crack-7"),
        ("Riß 7", "Riß 7"),
        ("../../etc/passwd", "-..-etc-passwd"),
        ("a\tb\n", "a-b-"),
        ("con.", "con"),
        ("\u202eabc", "-abc"),
        ("e\u0301", "é"),
        ("", ""),
    ],
)
def test_a_label_becomes_a_part_of_a_file_name_on_any_system(label: str, name: str):
    assert safe_name(label) == name
    assert capture_name(7, label) == "manual-000007" + (f"-{name}" if name else "")


def test_a_long_label_is_cut_between_letters_and_groups_are_names_as_they_stand():
    assert len(capture_name(1, "…" * 200).encode()) < 120
    assert is_group_name("Riß 7")
    assert not any(is_group_name(name) for name in ("", "a/b", "..", ".", " a", "a\n"))


def test_the_label_is_found_in_name_folder_file_and_events(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        taken = [await lab.engine.capture(ManualRequest(label)) for label in ("crack-7", "crack-7", 'a "b" \\ ü')]
        await lab.clock.sleep(60.0)
        names = [one.name for one in taken]
        assert names == ["manual-000002-crack-7", "manual-000003-crack-7", "manual-000004-a -b- - ü"]
        assert [capture_file(lab, name)["label"] for name in names] == ["crack-7", "crack-7", 'a "b" \\ ü']
        assert [event["label"] for event in events(lab, "capture.completed")] == ["rest", *(one.label for one in taken)]
        assert [(event["capture"], event["label"]) for event in events(lab, "envelope")] == [
            (one.name, one.label) for one in taken
        ]

    simulate(scenario)


def test_the_folder_is_a_data_set_folder_and_a_changed_rig_keeps_the_old_file(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        await lab.engine.capture(ManualRequest())
        await lab.clock.sleep(30.0)
        folder = lab.data / "campaigns" / MANUAL
        assert {path.name for path in folder.iterdir()} == {"rig.toml", "control.csv", "sharp", "captures", "results"}
        (folder / "rig.toml").write_text("# of another day")
        await lab.kill()
        lab.start()
        await lab.engine.capture(ManualRequest())
        assert (folder / "rig.toml").read_text() == ""
        assert (folder / "rig-1.toml").read_text() == "# of another day"

    simulate(scenario)


def test_what_is_stated_comes_along_everywhere(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        await lab.clock.sleep(10.0)
        request = ManualRequest("s", frequency_hz=5.0, amplitude_mm=2.0, phase_rad=0.5, exposure_s=2.0)
        lab.world.drive(True, 5.0, 2.0)
        taken = await lab.engine.capture(request)
        await lab.clock.sleep(30.0)
        kept = capture_file(lab, taken.name)
        stated = {"frequency_hz": 5.0, "excitation_amplitude_mm": 2.0, "exposure_s": 2.0}
        assert {name: kept[name] for name in stated} == stated
        assert kept["phase_rad"] == pytest.approx(0.5)
        [record] = records.captures(lab.journal, MANUAL, "measured")
        assert (record.frequency_hz, record.amplitude_mm, record.phase_rad, record.exposure_s) == (5.0, 2.0, 0.5, 2.0)
        for event in (events(lab, "capture.completed")[-1], events(lab, "envelope")[-1]):
            assert {name: event[name] for name in stated} == stated
        assert events(lab, "fault") == []

    simulate(scenario, has_shaker=False)


def test_what_nobody_states_is_taken_from_the_table_gauge(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        await lab.clock.sleep(10.0)
        lab.world.drive(True, 7.25, 0.8)
        taken = await lab.engine.capture(ManualRequest("seen"))
        wrong = await lab.engine.capture(ManualRequest("wrong", frequency_hz=8.0, amplitude_mm=0.8))
        await lab.clock.sleep(60.0)
        kept = capture_file(lab, taken.name)
        assert (kept["frequency_hz"], kept["excitation_amplitude_mm"]) == (7.25, 0.8)
        assert capture_file(lab, wrong.name)["frequency_hz"] == 8.0
        [fault] = events(lab, "fault")
        assert fault["device"] == "table"
        assert "7.25 Hz where 8 Hz was stated" in fault["message"]

    simulate(scenario, has_shaker=False)


def test_at_rest_nothing_is_invented_and_a_dumb_gauge_is_reported_once(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        taken = await lab.engine.capture(ManualRequest("still"))
        await lab.clock.sleep(30.0)
        assert {"frequency_hz", "excitation_amplitude_mm"}.isdisjoint(capture_file(lab, taken.name))
        lab.world.fail("table.find_sine", "silent", "silent")
        for _ in range(2):
            await lab.engine.capture(ManualRequest())
            await lab.clock.sleep(30.0)
        assert [fault["device"] for fault in events(lab, "fault")] == ["table"]
        assert len(events(lab, "envelope")) == 3

    simulate(scenario)


def test_a_sharp_set_of_a_moving_table_gives_no_rest_position(simulate):
    async def scenario(lab: FakeLab):
        lab.world.drive(True, 7.25, 0.8)
        taken = await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        await lab.clock.sleep(15.0)
        note = lab.data / "campaigns" / MANUAL / "sharp" / taken.name / "set.toml"
        assert note.read_text() == "at_rest = false\n"
        [fault] = events(lab, "fault")
        assert "0.8 mm at 7.25 Hz" in fault["message"]

    simulate(scenario, has_shaker=False)


@pytest.mark.parametrize(
    ("seen", "stated", "words"),
    [
        (TableMotion("g", 5.0, 0.001, 2.0, 0.001), (5.0, 2.0), ""),
        (TableMotion("g", 5.0, 0.001, 2.0, 0.001), (5.004, 2.03), ""),
        (TableMotion("g", 5.0, 0.001, 2.0, 0.001), (5.1, None), "5 Hz where 5.1 Hz was stated"),
        (TableMotion("g", 5.0, 0.001, 2.0, 0.001), (None, 2.2), "2 mm where 2.2 mm was stated"),
        (TableMotion("g", 5.0, 0.5, 2.0, 0.5), (5.1, 2.2), ""),
        (TableMotion("g", None, 0.0, 0.001, 0.001), (5.0, None), "no motion where 5 Hz was stated"),
        (TableMotion("g", None, 0.0, 0.001, 0.001), (5.0, 2.0), "0.001 mm where 2 mm was stated"),
        (TableMotion("g", None, 0.0, None, 0.0), (None, None), ""),
    ],
)
def test_stated_against_measured_beyond_three_sd(seen: TableMotion, stated: tuple[Any, Any], words: str):
    found = contradiction(seen, *stated)
    assert (found is not None) == bool(words)
    assert words in str(found)


def test_a_group_is_measured_jointly_once_it_is_quiet_and_again_when_a_member_comes_late(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        for phase_rad in (0.0, 1.57):
            await lab.engine.capture(ManualRequest("g", group="turn", frequency_hz=5.0, phase_rad=phase_rad))
        assert events(lab, "envelope") == []
        await lab.clock.sleep(60.0)
        [first] = events(lab, "envelope")
        assert (first["capture"], len(first["targets"])) == ("turn", 4)
        await lab.engine.capture(ManualRequest(is_sharp=True))
        await lab.engine.capture(ManualRequest("late", group="turn", frequency_hz=5.0))
        await lab.engine.capture(ManualRequest("alone"))  # another one: the group is complete
        await lab.clock.sleep(15.0)
        assert sorted((event["capture"], len(event["targets"])) for event in events(lab, "envelope")[1:]) == [
            ("manual-000006-alone", 2), ("turn", 6),
        ]  # fmt: skip
        kept = list(records.results(lab.journal, MANUAL))
        assert sorted(result.name for result in kept) == ["manual-000006-alone", "turn"]
        sets = {one.sharp for one in records.group_members(lab.journal, MANUAL, "turn")}
        assert sets == {"manual-000001"}  # one for all members
        with pytest.raises(InvalidParamsError, match="is the name of a capture"):
            await lab.engine.capture(ManualRequest(group="manual-000006-alone"))

    simulate(scenario)


def test_without_a_sharp_set_it_is_said_once_and_captures_wait_for_it(simulate):
    async def scenario(lab: FakeLab):
        for _ in range(5):
            await lab.engine.capture(ManualRequest("early"))
            await lab.clock.sleep(30.0)
        [fault] = events(lab, "fault")
        assert "labdaemon capture --sharp" in fault["message"]
        assert events(lab, "envelope") == []
        await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        await lab.clock.sleep(60.0)
        assert len(events(lab, "envelope")) == 5
        assert capture_file(lab, "manual-000001-early")["sharp"] == "manual-000006-rest"
        assert len(events(lab, "fault")) == 1

    simulate(scenario)


def test_what_cannot_be_measured_for_one_reason_is_said_once(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        lab.measurer.refusal = "only 2 of 8 control targets were found"
        for _ in range(4):
            await lab.engine.capture(ManualRequest())
            await lab.clock.sleep(30.0)
        assert len(events(lab, "fault")) == 1
        assert len(records.captures(lab.journal, MANUAL, "unmeasured")) == 4

    simulate(scenario)


def test_the_next_outside_release_is_the_capture_that_was_announced(simulate):
    async def scenario(lab: FakeLab):
        await lab.clock.sleep(5.0)
        announced = await lab.engine.capture(ManualRequest("rest", is_sharp=True, request_id="q"))
        assert (announced.name, announced.opened_at) == ("manual-000001-rest", None)
        await fire_outside(lab)
        assert records.reply_to(lab.journal, "q") is not None
        asking = asyncio.create_task(lab.engine.capture(ManualRequest("crack", exposure_s=1.3)))
        await lab.clock.sleep(2.0)
        await fire_outside(lab)
        taken = await asking
        assert taken.opened_at is not None
        opened_s = (datetime.fromisoformat(taken.opened_at) - lab.clock.now()).total_seconds()
        assert opened_s == pytest.approx(-15.0, abs=2.1)  # when it opened, not when its files had come
        await fire_outside(lab)
        names = [event["capture"] for event in events(lab, "envelope")]
        assert names == ["manual-000002-crack", "manual-000003-outside"]
        assert capture_file(lab, names[0])["exposure_s"] == 1.3
        assert "exposure_s" not in capture_file(lab, names[1])  # not stated, and the frame does not say
        assert events(lab, "fault") == []

    simulate(scenario, has_trigger=False)


def test_an_announced_release_that_does_not_come_is_forgotten(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        await lab.clock.sleep(700.0)
        await fire_outside(lab)
        [event] = events(lab, "capture.completed")
        assert (event["label"], event["sharp"]) == ("outside", False)

    simulate(scenario, has_trigger=False)


def test_a_release_is_kept_when_a_campaign_begins_in_the_middle_of_it(simulate):
    async def scenario(lab: FakeLab):
        await lab.clock.sleep(5.0)
        for camera in lab.fake.cameras:
            camera.release(1.0)
        await lab.clock.sleep(1.6)
        id = await lab.submit('name = "w"\n[[phase]]\nkind = "pause"\nduration_s = 60\n')
        await lab.until(id)
        [event] = events(lab, "capture.completed")
        assert event["label"] == "outside"

    simulate(scenario, has_trigger=False)


def test_stored_manual_captures_are_measured_after_a_restart(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        lab.measurer.measure_s = 500.0
        await lab.engine.capture(ManualRequest("before"))
        await lab.clock.sleep(30.0)
        await lab.kill()
        lab.measurer.measure_s = 1.0
        lab.start()
        await lab.clock.sleep(30.0)
        assert [event["capture"] for event in events(lab, "envelope")] == ["manual-000002-before"]
        again = await lab.engine.capture(ManualRequest("before"))  # the same label of another day is another capture
        assert again.name == "manual-000003-before"

    simulate(scenario)


def test_without_a_shaker_the_box_sees_outside_releases_between_captures_of_ours(tmp_path: Path):
    clock = SimulatedClock()
    rig = fake_rig(clock)
    rig.rig = replace(rig.rig, shaker=None)

    async def scenario() -> None:
        lab = FakeLab(tmp_path, clock, rig=rig)
        lab.start()
        await lab.engine.capture(ManualRequest("rest", is_sharp=True))
        await lab.clock.sleep(10.0)
        lab.fake.trigger.edge(1.0)
        await lab.clock.sleep(10.0)
        await lab.engine.capture(ManualRequest("ours"))
        await lab.clock.sleep(10.0)
        lab.fake.trigger.edge(1.0)
        await lab.clock.sleep(20.0)
        labels = [(event["label"], event["phase_rad"]) for event in events(lab, "capture.completed")]
        assert labels == [("rest", None), ("outside", 0.5), ("ours", None), ("outside", 0.5)]
        assert len(events(lab, "envelope")) == 3
        assert events(lab, "fault") == []
        await lab.kill()

    clock.run(scenario())
