"""What gauges saw during a capture is in its event, the journal, capture.toml and gauges.csv. In simulated time."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path
from typing import Any

import pytest

from labdaemon.campaign.manual_request import ManualRequest
from labdaemon.journal.gauge_records import gauges_in
from labdaemon.journal.gauge_table import GAUGE_COLUMNS, gauges_text
from labdaemon.testing.lab import FakeLab

MANUAL = "0000-manual"
CAMPAIGN = """
name = "recorded"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0]
amplitude_mm = [2.0, 1.0]
exposure_s = 1.0
on_fault = "retry"
"""


def completed(lab: FakeLab, campaign: str) -> dict[str, dict[str, Any]]:
    """Gauges of each capture as its event has them, by name of the gauge."""
    return {
        event.data["capture"]: {one["gauge"]: one for one in event.data["gauges"]}
        for event in lab.journal.events_after(0, 10_000)
        if event.kind == "capture.completed" and event.campaign == campaign
    }


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "results" / "gauges.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_campaigns_captures_carry_amplitude_phase_and_harmonics(simulate):
    async def scenario(lab: FakeLab):
        lab.fake.gauges[0].third = 0.05
        id = await lab.submit(CAMPAIGN)
        await lab.until(id)
        folder, event = lab.data / "campaigns" / id, completed(lab, id)
        for capture, frequency_hz, amplitude_mm in (
            ("00001-steps-5.000hz-01", 5.0, 2.0),
            ("00002-steps-8.000hz-01", 8.0, 1.0),
        ):
            table = event[capture]["table"]
            assert table["frequency_hz"] == pytest.approx(frequency_hz, abs=0.01)
            assert table["amplitude_mm"] == pytest.approx(amplitude_mm, rel=1e-3)
            assert table["h3_mm"] == pytest.approx(0.05 * amplitude_mm, rel=1e-2)
            assert table["h3_phase_rad"] == pytest.approx(0.0, abs=0.05)
            assert 0 < table["sd_amplitude_mm"] < 1e-3
            assert event[capture]["response"]["amplitude_mm"] == pytest.approx(3 * amplitude_mm, rel=0.02)
            written = tomllib.loads((folder / "captures" / capture / "capture.toml").read_text())["gauges"]["table"]
            assert written == {name: value for name, value in table.items() if name != "gauge"}
        assert [(row["capture"][-13:], row["gauge"]) for row in rows(folder)] == [
            ("steps-5.000hz-01"[-13:], "response"),
            ("steps-5.000hz-01"[-13:], "table"),
            ("steps-8.000hz-01"[-13:], "response"),
            ("steps-8.000hz-01"[-13:], "table"),
        ]
        assert tuple(rows(folder)[0]) == GAUGE_COLUMNS
        assert (folder / "results" / "gauges.csv").read_text() == gauges_text(gauges_in(lab.journal, id))
        assert event["00000-sharp-01"]["table"]["reason"] == "no sine stands out from the noise"

    simulate(scenario)


@pytest.mark.parametrize("fault", ["gone", "silent", "rubbish", "slow"])
def test_a_gauge_that_is_silent_is_reported_and_the_capture_goes_through(simulate, fault):
    async def scenario(lab: FakeLab):
        lab.world.fail("response.record", *[fault] * 3)
        id = await lab.submit(CAMPAIGN)
        record = await lab.until(id)
        assert record.state == "completed"
        event = completed(lab, id)
        assert len(event) == 3
        for gauges in event.values():
            assert gauges["response"]["reason"]
            assert "amplitude_mm" not in gauges["response"]
        assert event["00001-steps-5.000hz-01"]["table"]["amplitude_mm"] == pytest.approx(2.0, rel=1e-3)
        assert all(row["reason"] for row in rows(lab.data / "campaigns" / id) if row["gauge"] == "response")

    simulate(scenario)


def test_a_manual_capture_is_recorded_at_the_frequency_that_the_gauge_shows(simulate):
    async def scenario(lab: FakeLab):
        await lab.engine.capture(ManualRequest(is_sharp=True))
        await lab.clock.sleep(10.0)
        lab.world.drive(True, 7.25, 0.8)
        taken = await lab.engine.capture(ManualRequest("seen"))
        await lab.clock.sleep(60.0)
        table = completed(lab, MANUAL)[taken.name]["table"]
        assert table["frequency_hz"] == pytest.approx(7.25, abs=0.01)
        assert table["amplitude_mm"] == pytest.approx(0.8, rel=1e-3)
        assert table["duration_s"] >= 1.0
        [row] = [row for row in rows(lab.data / "campaigns" / MANUAL) if row["gauge"] == "table"]
        assert float(row["amplitude_mm"]) == table["amplitude_mm"]

    simulate(scenario, has_shaker=False)


def test_an_outside_release_is_recorded_too_without_a_phase(simulate):
    async def scenario(lab: FakeLab):
        await lab.clock.sleep(5.0)
        lab.world.line_wired = False
        lab.world.drive(True, 6.0, 1.5)
        for camera in lab.fake.cameras:
            camera.release(1.0)
        await lab.clock.sleep(30.0)
        [gauges] = completed(lab, MANUAL).values()
        assert gauges["table"]["amplitude_mm"] == pytest.approx(1.5, rel=2e-3)
        assert "phase_rad" not in gauges["table"]

    simulate(scenario, has_trigger=False)


def test_the_phase_counts_from_the_excitations_reference(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(CAMPAIGN.replace("exposure_s = 1.0", "exposure_s = 1.0\nphase_rad = [0.0, 1.5]"))
        await lab.until(id)
        for capture, gauges in completed(lab, id).items():
            table = gauges["table"]
            if "sharp" in capture:
                continue
            assert table["sd_phase_rad"] >= 2 * 3.14 * table["frequency_hz"] * 1e-3
        assert len(completed(lab, id)) == 5

    simulate(scenario)


def test_a_lost_or_changed_file_is_written_anew(simulate):
    async def scenario(lab: FakeLab):
        id = await lab.submit(CAMPAIGN)
        await lab.until(id)
        path = lab.data / "campaigns" / id / "results" / "gauges.csv"
        whole = path.read_text()
        await lab.kill()
        path.unlink()
        lab.start()
        await lab.clock.sleep(10.0)
        assert path.read_text() == whole

    simulate(scenario)
