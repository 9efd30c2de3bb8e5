"""The paper's own wiring, through real processes: others shake and fire; the daemon measures and calls a person."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from labdaemon.processing import read_csv
from labdrivers.scpi import ScpiShaker
from labdrivers.trigger_box import TriggerBox

LABDAEMON = [sys.executable, "-c", "from labdaemon.cli.main import main; main()"]

pytestmark = pytest.mark.slow


@pytest.fixture
def outside_rig() -> Iterator[Any]:
    """A simulated rig with frames that can be measured, whose amplifier needs no enable line."""
    [entry] = entry_points(group="labdaemon.simulators", name="rig")
    with entry.load()(seed=3, enable_wired=False) as running:
        yield running


def until(condition: Callable[[], Any], timeout_s: float = 200.0) -> Any:
    end = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end, "it did not come to that in time"
        time.sleep(0.2)
    return found


def labdaemon(*arguments: str) -> str:
    return subprocess.run([*LABDAEMON, *arguments], check=True, capture_output=True, text=True, timeout=300).stdout


def without_own_table(text: str, hook: Path) -> str:
    """The rig file of an outside system: no shaker and no trigger of ours; faults go to a script."""
    for head in (r"\[shaker\]", r"\[shaker\.limits\]", r"\[interlocks\]", r"\[trigger\]", r"\[lamp\]"):
        text = re.sub(head + r"\n(?:(?!\[).*\n)*", "", text)
    command = json.dumps(
        [sys.executable, "-c", "import sys; open(sys.argv[1], 'w').write(sys.stdin.read())", str(hook)]
    )
    return text.replace("[service]\n", f"[service]\non_fault = {command}\n") + '\n[trigger]\ndriver = "camera"\n'


def test_captures_that_others_fire_become_envelopes_that_process_reproduces(
    outside_rig: Any, tmp_path: Path, daemons: list[Any], start_daemon: Any, free_addresses: tuple[str, str]
) -> None:
    events, commands = free_addresses
    config = outside_rig.write_files(tmp_path, events=events, commands=commands, data=str(tmp_path / "data"))
    settings = tomllib.loads(config.read_text())
    config.write_text(without_own_table(config.read_text(), tmp_path / "hook.json"))
    shaker = ScpiShaker("shaker", settings["shaker"])
    box = TriggerBox("trigger", settings["trigger"])
    box.connect()
    daemons.append(start_daemon(config, tmp_path / "data"))
    daemon = daemons[0].ready()

    def reported(kind: str) -> list[dict[str, Any]]:
        return [one["data"] for one in daemon.ask("events.replay", after=0)["events"] if one["kind"] == kind]

    def fire(label: str, *options: str) -> str:
        stored = len(reported("capture.completed"))
        asked = subprocess.Popen(
            [*LABDAEMON, "capture", "--label", label, "--json", "--address", commands, *options],
            stdout=subprocess.PIPE,
            text=True,
        )
        until(lambda: daemon.ask("status")["captures_expected"] == 1)
        box.fire(1.0)
        answer = json.loads(asked.communicate(timeout=200)[0])
        until(lambda: len(reported("capture.completed")) > stored)
        return str(answer["capture"])

    fire("rest", "--sharp")
    shaker.connect()
    shaker.set(5.0, 2.0)
    time.sleep(4.5)  # the gauge's record holds nothing but the motion
    seen = fire("crack 7")
    wrong = fire("wrong", "--frequency-hz", "8", "--exposure-s", "1.0")
    until(lambda: len(reported("envelope")) == 2)
    shaker.stop()
    shaker.close()
    box.close()

    # Two workers measure two captures at once: either may be ready first.
    envelopes = {one["capture"]: one for one in reported("envelope")}
    assert set(envelopes) == {seen, wrong}
    first = envelopes[seen]
    assert first["label"] == "crack 7"
    assert first["frequency_hz"] == pytest.approx(5.0, abs=0.01)
    assert first["excitation_amplitude_mm"] == pytest.approx(2.0, rel=0.05)
    assert first["exposure_s"] == pytest.approx(1.0)  # as the frames state it
    clean = [target for target in first["targets"] if not target["flags"]]
    assert len(clean) > 20
    assert max(abs(target["ax_mm"]) for target in clean) > 1.5
    [fault] = reported("fault")
    assert "where 8 Hz was stated" in fault["message"]
    until(lambda: (tmp_path / "hook.json").is_file() and (tmp_path / "hook.json").read_text())
    assert json.loads((tmp_path / "hook.json").read_text())["data"] == fault

    folder = tmp_path / "data" / "campaigns" / "0000-manual"
    labdaemon("process", str(folder), "--out", str(tmp_path / "again"), "--no-overlay")
    again, live = read_csv(tmp_path / "again" / "envelope.csv"), read_csv(folder / "results" / "envelope.csv")
    assert sorted(again, key=str) == sorted(live, key=str)
    labdaemon("report", str(folder))
    page = (folder / "results" / "index.html").read_text()
    assert "label crack 7" in page
    status = daemon.ask("status")
    assert (status["captures_manual"], status["rig"], status["pid"]) == (3, str(config), daemon.process.pid)
    assert daemon.end()[0] == 0
