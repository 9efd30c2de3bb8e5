"""The examples of ten lines run as they stand in the documentation, against a light daemon at other addresses."""

from __future__ import annotations

import csv
import re
import threading
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import matplotlib as mpl
import pytest

import labdaemon as ld
from labdaemon.stream.client import Client
from labdaemon.testing.stream_daemon import StreamDaemon

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "follow-and-command-in-ten-lines.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^## (.+?)\n.*?```python\n(.*?)```", PAGE, flags=re.MULTILINE | re.DOTALL))
ROW = {"target": "t1", "ax_mm": 1.0, "ay_mm": 0.0, "az_mm": 0.0, "bx_mm": 0.5, "by_mm": 0.0, "bz_mm": 0.0, "flags": []}
MOST_LINES = 10


class EndOfExample(Exception):
    """Ends an example that has no end."""


class Ending(StringIO):
    """Ends the example once it has printed a word."""

    def __init__(self, word: str) -> None:
        super().__init__()
        self._word = word

    def write(self, text: str) -> int:
        size = super().write(text)
        if self._word in self.getvalue():
            raise EndOfExample
        return size


@pytest.fixture(scope="module")
def daemon() -> Iterator[StreamDaemon]:
    daemon = StreamDaemon()
    daemon.start()
    daemon.publish("envelope", {"capture": "0001-a", "targets": [ROW]})
    yield daemon
    daemon.stop()


@pytest.fixture
def addresses(daemon: StreamDaemon, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Clients find the daemon where they look for it by default."""
    monkeypatch.chdir(tmp_path)
    for kind in (Client, ld.AsyncClient):
        monkeypatch.setattr(kind.__init__, "__defaults__", (daemon.commands, daemon.events))


def run(title: str, daemon: StreamDaemon, end: str = "\0") -> str:
    code = BLOCKS[title].replace("tcp://127.0.0.1:5570", daemon.commands).replace("tcp://127.0.0.1:5571", daemon.events)
    out = Ending(end)
    with redirect_stdout(out), suppress(EndOfExample):
        exec(compile(code, title, "exec"), {"__name__": "__main__"})
    return out.getvalue()


@pytest.fixture
def later(daemon: StreamDaemon) -> Iterator[None]:
    """More envelopes come while the example runs."""
    is_over = threading.Event()

    def publish() -> None:
        while not is_over.wait(0.1):
            daemon.publish("envelope", {"capture": "0001-a", "targets": [ROW]})

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    yield
    is_over.set()
    thread.join(20)


def test_no_example_is_longer_than_ten_lines() -> None:
    assert len(BLOCKS) == 6
    for title, code in BLOCKS.items():
        assert len([line for line in code.splitlines() if line.strip()]) <= MOST_LINES, title


def test_watch_envelopes(daemon: StreamDaemon, addresses: None) -> None:
    assert "0001-a [('t1', 1." in run("Watch envelopes", daemon, end=")]")


def test_trigger_a_capture(daemon: StreamDaemon, addresses: None, later: None) -> None:
    said = run("Trigger a capture and wait for its envelope", daemon)
    assert said.startswith("0001-a opened at 2026-05-04")
    assert said.endswith("1 targets\n")
    assert ("capture", {"label": "from my program", "frequency_hz": 5.0, "request_id": "shot-1"}) in daemon.asked


def test_log_to_csv(daemon: StreamDaemon, addresses: None, later: None, monkeypatch: pytest.MonkeyPatch) -> None:
    rows: list[list[object]] = []

    class Writer:
        def writerow(self, row: list[object]) -> None:
            rows.append(row)
            if len(rows) == 3:
                raise EndOfExample

    monkeypatch.setattr(csv, "writer", lambda file: Writer())
    run("Log to CSV, for weeks", daemon)
    assert [row[2:] for row in rows] == [["t1", 1.0, 0.5]] * 3
    assert Path("log.csv").exists()


def test_plot_live(daemon: StreamDaemon, addresses: None, monkeypatch: pytest.MonkeyPatch) -> None:
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    def pause(seconds: float) -> None:
        raise EndOfExample

    monkeypatch.setattr(plt, "pause", pause)
    run("Plot live", daemon)
    assert len(plt.gca().patches) == 1
    plt.close("all")


def test_bare_pyzmq(daemon: StreamDaemon, later: None) -> None:
    said = run("With nothing but pyzmq", daemon)
    assert "events before this one" in said
    assert said.rstrip().endswith("0001-a")


def test_an_event_loop(daemon: StreamDaemon, addresses: None) -> None:
    assert run("In a program with an event loop", daemon, end="1 envelope").startswith("idle\n")
