"""Modules of ours as processes of their own."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path

import pytest

from labdaemon.child_program import run_module


@pytest.fixture
def python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A script that runs instead of Python."""
    script = tmp_path / "python"
    script.touch(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    return script


def test_output_status_and_the_last_line_of_complaints() -> None:
    result = asyncio.run(run_module("labdaemon", "--version", longest_s=120.0, niceness=1))
    assert (result.status, result.complaint) == (0, "")
    assert b"labdaemon" in result.output
    refused = asyncio.run(run_module("labdaemon", "nothing", longest_s=120.0, niceness=1))
    assert refused.status == 2
    assert "nothing" in refused.complaint


def test_one_that_does_not_end_is_killed_with_its_children(python: Path, tmp_path: Path) -> None:
    python.write_text(f"#!/bin/sh\nsleep 600 &\necho $! > {tmp_path}/pid\nwait\n")

    async def run() -> None:
        waiting = asyncio.create_task(run_module("m", longest_s=3600.0, niceness=1))
        async with asyncio.timeout(60):
            while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
                await asyncio.sleep(0.02)
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)

    asyncio.run(run())
    child = Path("/proc") / (tmp_path / "pid").read_text().strip() / "stat"
    end = time.monotonic() + 60
    while child.exists() and child.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < end, "it is still running"
        time.sleep(0.02)


def test_time_is_bounded(python: Path) -> None:
    python.write_text("#!/bin/sh\nexec sleep 600\n")
    with pytest.raises(TimeoutError):
        asyncio.run(run_module("m", longest_s=0.1, niceness=1))


def test_its_priority_is_lower(python: Path) -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    python.write_text(f'#!/bin/sh\nwhile [ "$(nice)" = {own} ]; do sleep 0.02; done\nnice\n')
    result = asyncio.run(run_module("m", longest_s=120.0, niceness=3))
    assert int(result.output) == own + 3


def test_one_that_cannot_start_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with pytest.raises(FileNotFoundError):
        asyncio.run(run_module("m", longest_s=1.0, niceness=1))
