"""The demo's parts, and the whole: rig, daemon, campaign, accuracy, page, in processes of their own."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zmq

from labdaemon.cli import demo_lab
from labdaemon.cli.demo import THREE_MODES, accuracy_lines, free_folder
from labdaemon.cli.demo_lab import DemoFailed, laboratory
from labdaemon.cli.demo_results import check_same_numbers, truth_of, write_truth
from labdaemon.clock import rfc3339
from labdaemon.errors import UsageError
from labdaemon.processing.tables import ENVELOPE_COLUMNS, write_csv
from labdaemon.report.accuracy import compare, read_truth

CONFIG = Path(__file__).parents[2] / "config"
ONE_MODE = """
name = "one-mode"
[[phase]]
kind = "sharp"
frames = 1
[[phase]]
kind = "steps"
frequency_hz = 12.0
amplitude_mm = 0.5
"""
NOON = datetime(2026, 5, 4, 12, tzinfo=UTC)


def envelope_rows(capture: str, count: int = 3) -> list[dict[str, Any]]:
    rows = []
    for index in range(count):
        row: dict[str, Any] = dict.fromkeys(ENVELOPE_COLUMNS, 0.125 * index)
        flags = ["at_rest"] if index == 0 else []
        rows.append(row | {"capture": capture, "target": f"T{index}", "flags": flags})
    return rows


def test_the_built_in_campaign_is_the_one_in_config() -> None:
    def content(text: str) -> list[str]:
        return [line.partition("#")[0].rstrip() for line in text.splitlines() if line.partition("#")[0].strip()]

    assert content(THREE_MODES) == content((CONFIG / "campaigns" / "three-modes.toml").read_text())


def test_each_capture_gets_the_truth_of_its_own_moment() -> None:
    records = [
        {"opened_at": rfc3339(NOON + timedelta(seconds=20 * place)), "targets": {"T0": {"x_mm": float(place)}}}
        for place in range(4)
    ]
    envelopes = [
        {"capture": "b", "opened_at": rfc3339(NOON + timedelta(seconds=39.9))},
        {"capture": "a", "opened_at": rfc3339(NOON + timedelta(seconds=0.06))},
    ]
    truth = truth_of(envelopes, records)
    assert truth == {"b": [{"target": "T0", "x_mm": 2.0}], "a": [{"target": "T0", "x_mm": 0.0}]}
    with pytest.raises(DemoFailed, match="no exposure"):
        truth_of([{"capture": "c", "opened_at": rfc3339(NOON + timedelta(seconds=10))}], records)


def test_truth_is_written_as_it_is_read(tmp_path: Path) -> None:
    values = {
        f"{name}_mm": float(place) for place, name in enumerate(("x", "y", "z", "ax", "ay", "az", "bx", "by", "bz"))
    }
    write_truth(tmp_path / "truth.csv", {"c1": [{"target": "T0", **values}]})
    (row,) = read_truth(tmp_path / "truth.csv")["c1"]
    assert (row["target"], row["x_mm"], row["az"], row["bz"]) == ("T0", 0.0, 5.0, 8.0)


def test_what_was_sent_and_what_was_stored_are_compared_to_the_last_cell(tmp_path: Path) -> None:
    write_csv(tmp_path / "envelope.csv", ENVELOPE_COLUMNS, [*envelope_rows("c1"), *envelope_rows("c2")])
    sent = [{"capture": name, "targets": envelope_rows(name)} for name in ("c2", "c1")]
    assert check_same_numbers(sent, tmp_path) == 6
    sent[0]["targets"][2]["sd_bz_mm"] = 0.25001
    with pytest.raises(DemoFailed, match="c2, T2: sd_bz_mm differs"):
        check_same_numbers(sent, tmp_path)
    with pytest.raises(DemoFailed, match="envelopes came for c1"):
        check_same_numbers(sent[1:], tmp_path)


def test_folders_are_taken_only_when_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert free_folder(None) == tmp_path / "labdaemon-demo"
    assert free_folder(None) == tmp_path / "labdaemon-demo-2"
    assert free_folder(Path("labdaemon-demo")) == tmp_path / "labdaemon-demo"
    (tmp_path / "labdaemon-demo" / "x").touch()
    with pytest.raises(UsageError, match="not empty"):
        free_folder(Path("labdaemon-demo"))
    with pytest.raises(UsageError, match="cannot be used"):
        free_folder(tmp_path / "labdaemon-demo" / "x")


def test_the_table_of_errors_pools_all_captures() -> None:
    true = [{"target": "A", "x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0, "ax": 1.0, "ay": 0.0, "az": 0.0}]
    rows = [{**true[0], "ax_mm": 1.01, "ay_mm": 0.0, "az_mm": 0.0, "flags": []}]
    lines = accuracy_lines([compare("c1", rows, true), compare("c2", rows, true)])
    assert lines[2].split() == ["c1", "1", "1", "1", "+0.0100", "–", "0.0100"]
    assert lines[-1].split() == ["all", "2", "2", "2", "+0.0100", "0.0000", "0.0100"]


@contextlib.contextmanager
def demo(*args: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """`labdaemon demo` as a person starts it; killed if the test leaves it running."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "labdaemon", "demo", *args],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_campaign_beyond_the_rig_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "far.toml").write_text(ONE_MODE.replace("0.5", "50.0"))
    with demo("--out", "out", "--campaign", "far.toml", cwd=tmp_path) as process:
        _, err = process.communicate(timeout=200)
    assert process.returncode == 2
    assert re.fullmatch(r"labdaemon: .*phase\[1\]\.amplitude_mm: 50 mm at 12 Hz: .*\n", err)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_whole_demo(tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text(ONE_MODE)
    with demo("--out", "out", "--campaign", "one.toml", cwd=tmp_path) as process:
        out, err = process.communicate(timeout=250)
    assert process.returncode == 0, err
    pooled = next(line for line in out.splitlines() if line.startswith("all")).split()
    targets, unflagged, compared = map(int, pooled[1:4])
    mean_mm, sd_mm = map(float, pooled[4:6])
    assert targets >= 20
    assert unflagged >= 0.95 * targets
    assert compared >= 15
    assert abs(mean_mm) <= 0.01
    assert sd_mm <= 0.02
    folder = tmp_path / "out"
    assert len(list(folder.glob("results/overlay/*.png"))) == 2
    assert len(list(folder.glob("captures/*/*.dng"))) == 2
    assert {path.name for path in folder.glob("sharp/*")} == {"left.dng", "right.dng"}
    page = (folder / "results" / "index.html").read_text()
    assert page.count("<svg") == 3  # the set-up, the envelopes, the gauges
    assert "http" not in page
    again = [sys.executable, "-m", "labdaemon", "process", "out", "--out", "again", "--no-overlay"]
    subprocess.run(again, cwd=tmp_path, check=True, capture_output=True, timeout=200)
    for name in ("envelope.csv", "measurements.csv"):
        assert (tmp_path / "again" / name).read_text() == (folder / "results" / name).read_text()


@pytest.mark.slow
@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_interrupted_it_ends_everything_it_started(tmp_path: Path, number: int, expected: int) -> None:
    with demo("--out", "out", cwd=tmp_path) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "step" in line:
                break
        children = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True
        ).stdout.split()
        assert len(children) >= 2
        process.send_signal(number)
        time.sleep(0.2)
        process.send_signal(number)  # a second one does not cut the ending short
        assert process.wait(120) == expected
    deadline = time.monotonic() + 60
    while any(Path("/proc", pid).exists() for pid in children):
        assert time.monotonic() < deadline, f"still there: {children}"
        time.sleep(0.05)


def shake_and_kill(folder: Path) -> None:
    """Kill the daemon while its table moves."""
    with laboratory(folder) as lab:
        pid = lab.client.call("rig")["pid"]
        lab.client.call("campaign.submit", toml=ONE_MODE)
        for _ in lab.events():
            if lab.rig.table()["moving"]:
                os.kill(pid, signal.SIGKILL)


@pytest.mark.slow
def test_a_daemon_that_is_killed_leaves_no_moving_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start, last = demo_lab.simulator("rig"), {}

    def watched(**options: Any) -> Any:
        rig = start(**options)
        close = rig.close

        def look_and_close() -> None:
            last.update(rig.table())
            close()

        monkeypatch.setattr(rig, "close", look_and_close)
        return rig

    monkeypatch.setattr(demo_lab, "simulator", lambda name: watched)
    with pytest.raises(DemoFailed, match="exit status -9"):
        shake_and_kill(tmp_path)
    assert last["moving"] is False


@pytest.mark.slow
def test_a_bare_subscriber_sees_every_event_once_and_the_numbers_of_the_csv(tmp_path: Path) -> None:
    with laboratory(tmp_path) as lab, zmq.Context() as context:
        events, commands = context.socket(zmq.SUB), context.socket(zmq.REQ)
        with events, commands:
            events.setsockopt(zmq.SUBSCRIBE, b"")
            events.connect(lab.client.events_address)
            commands.connect(lab.client.commands_address)
            assert events.recv_multipart()[0] == b"status"
            request = {"jsonrpc": "2.0", "id": 1, "method": "campaign.submit", "params": {"toml": ONE_MODE}}
            commands.send_json(request)
            campaign = commands.recv_json()["result"]
            received: list[dict[str, Any]] = []
            heartbeats = 0
            while not received or received[-1]["kind"] not in {"campaign.completed", "campaign.failed"}:
                assert events.poll(20_000), "silent"
                topic, body = events.recv_multipart()
                event = json.loads(body)
                assert topic.decode() == event["kind"]
                if event["kind"] == "status":
                    heartbeats += 1
                    assert event["seq"] == (received[-1]["seq"] if received else event["seq"])
                else:
                    received.append(event)
            commands.send_json({"jsonrpc": "2.0", "id": 2, "method": "events.replay", "params": {"after": 0}})
            replayed = commands.recv_json()["result"]
    seqs = [event["seq"] for event in received]
    assert seqs == list(range(seqs[0], seqs[0] + len(seqs)))
    assert replayed["events"][-len(received) :] == received
    assert heartbeats > 5
    assert {event["journal"] for event in received} == {replayed["journal"]}
    (envelope,) = [event["data"] for event in received if event["kind"] == "envelope"]
    with (Path(campaign["folder"]) / "results" / "envelope.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(envelope["targets"]) >= 20
    for row, target in zip(rows, envelope["targets"], strict=True):
        assert row["capture"] == envelope["capture"]
        assert row["flags"] == ";".join(target["flags"])
        assert row["target"] == target["target"]
        for column in set(row) - {"capture", "target", "flags"}:
            assert (float(row[column]) if row[column] else None) == target[column], column
    assert (envelope["frequency_hz"], envelope["excitation_amplitude_mm"]) == (12.0, 0.5)
