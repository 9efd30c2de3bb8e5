"""Campaigns, rig files, folders and frames with mistakes in them: refused in a line, soon, with little memory."""

from __future__ import annotations

import json
import random
import re
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labdaemon.bench.kill import small_rig
from labdaemon.bench.simulator import folder_maker
from labdaemon.bench.world.mutations import mutated_bytes, mutated_text
from labdaemon.bench.world.row import WorldOptions, WorldRow

MEMORY_MB = 500.0  # a hostile file may cost this, and not what the machine has
LONGEST_S = 10.0  # and so long, since a person waits for the answer
GOAL = f"0 tracebacks, 0 beyond {LONGEST_S:g} s, <= {MEMORY_MB:g} MB, one line on stderr"
CHILD = [sys.executable, "-m", "labdaemon.bench.world.fuzz_child"]
KILL_S = 90.0
"""A command that not even an alarm interrupts is killed after this long."""
HEAD_BYTES = 2048
"""Where a frame's tags lie."""
CAMPAIGN = """
name = "mutated"
notes = "a campaign of every kind of phase"
[[phase]]
kind = "sharp"
frames = 3
exposure_s = 0.25
[[phase]]
kind = "steps"
frequency_hz = [5.0, 8.0, 12.0]
amplitude_mm = [2.0, 1.0, 0.5]
captures = 2
exposure_s = 1.0
phase_rad = [0.0, 1.5708]
settle = { max_change_per_cycle = 0.001, timeout_s = 60 }
on_fault = "retry"
[[phase]]
kind = "sweep"
frequency_hz = { start = 4, stop = 14, count = 21, spacing = "log" }
velocity_mm_s = 20.0
exposure_s = 0.5
[[phase]]
kind = "dwell"
frequency_hz = 6.0
amplitude_mm = 0.5
hold_s = 30.0
exposure_s = 0.5
[[phase]]
kind = "external"
captures = 3
wait_s = 60.0
[[phase]]
kind = "pause"
duration_s = 5.0
"""


@dataclass(slots=True)
class FuzzFindings:
    """What a kind of input came to."""

    tries: int = 0
    refused: int = 0
    bad: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    memory_mb: float = 0.0

    def add(self, what: str, report: dict[str, Any]) -> None:
        """Judge one command's report."""
        self.tries += 1
        self.slowest_s = max(self.slowest_s, report["seconds"])
        self.memory_mb = max(self.memory_mb, report["memory_mb"])
        status, lines = report["status"], report["stderr"].strip().splitlines()
        self.refused += status != 0
        if status not in {0, 1, 2} or "Traceback" in report["stderr"] or (status and len(lines) != 1):
            last = lines[-1] if lines else ""
            self.bad.append(f"{what}: {status}, {len(lines)} lines, {last[:120]}")

    def row(self, what: str) -> WorldRow:
        """The row of the table."""
        result = (
            f"{self.refused} refused, {len(self.bad)} not as they must be, slowest {self.slowest_s:.1f} s of CPU, "
            f"{self.memory_mb:.0f} MB"
        )
        if self.bad:
            result += f" ({self.bad[0]})"
        holds = not self.bad and self.slowest_s <= LONGEST_S and self.memory_mb <= MEMORY_MB
        return WorldRow("fuzz", what, self.tries, result, GOAL, holds)


class FuzzCommands:
    """Runs `labdaemon` commands in a process that is started anew when it has died or hangs for good."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(self, *arguments: str | Path) -> dict[str, Any]:
        """One command's report, see `labdaemon.bench.world.fuzz_child`."""
        if self._process is None:
            self._process = subprocess.Popen(CHILD, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps([str(part) for part in arguments]) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], KILL_S)
        line = process.stdout.readline() if ready else ""
        if line:
            report: dict[str, Any] = json.loads(line)
            return report
        status = "died" if ready else "hang for good"
        self.close()
        return {"status": status, "stderr": "", "seconds": KILL_S, "memory_mb": 0.0}

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def rows(options: WorldOptions) -> Iterator[WorldRow]:
    """A row for each kind of file."""
    root = Path(tempfile.mkdtemp(prefix="labdaemon-fuzz-"))
    commands = FuzzCommands()
    source = random.Random(options.seed)
    try:
        yield _files(options, source, root, commands).row("campaign and rig files")
        folder = folder_maker()(root / "folder", targets=6, captures=1)
        yield _folders(options, source, folder, root, commands).row("data-set folders")
        yield _frames(options, source, folder, root, commands).row("frames")
    finally:
        commands.close()
        shutil.rmtree(root, ignore_errors=True)


def _files(options: WorldOptions, source: random.Random, root: Path, commands: FuzzCommands) -> FuzzFindings:
    """Mutated campaigns and rig files to `plan`."""
    found = FuzzFindings()
    where = root / "rig"
    where.mkdir()
    with small_rig(options.seed) as rig:
        config = rig.write_files(where, events="tcp://127.0.0.1:*", commands="tcp://127.0.0.1:*", data=str(root))
    rig_text, changed = config.read_text(), where / "changed.toml"
    campaign = root / "campaign.toml"
    for number in range(300 if options.quick else 5000):
        if number % 2:
            changed.write_bytes(mutated_text(source, rig_text))
            campaign.write_text(CAMPAIGN)
        else:
            changed.write_text(rig_text)
            campaign.write_bytes(mutated_text(source, CAMPAIGN))
        report = commands.run("plan", campaign, "--config", changed)
        found.add(_described(root, changed if number % 2 else campaign, report), report)
    return found


def _folders(
    options: WorldOptions, source: random.Random, folder: Path, root: Path, commands: FuzzCommands
) -> FuzzFindings:
    """A data-set folder with one of its text files changed, or a file missing, renamed or replaced, to `process`."""
    found = FuzzFindings()
    changed = root / "changed"
    for _ in range(12 if options.quick else 1000):
        shutil.rmtree(changed, ignore_errors=True)
        shutil.copytree(folder, changed, copy_function=_link)
        path = _mutate_folder(source, changed)
        report = commands.run("process", changed, "--workers", "1", "--no-overlay")
        found.add(_described(root, path, report), report)
    return found


def _mutate_folder(source: random.Random, folder: Path) -> Path:
    """Change one thing in a folder; which file it was."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    texts = [path for path in files if path.suffix in {".toml", ".csv"} and path.name != "truth.csv"]
    path = source.choice(texts)
    kind = source.randrange(8)
    if kind < 5:
        text = path.read_text()
        path.unlink()  # it is a link to the original
        path.write_bytes(mutated_text(source, text) if path.suffix == ".toml" else mutated_bytes(source, text.encode()))
        return path
    path = source.choice(files)
    data = path.read_bytes()
    if kind == 5:
        path.unlink()
    elif kind == 6:
        path.rename(path.with_name(source.choice(("x", "left-2.dng", "é.dng", ".hidden", "a.tif")) + path.suffix))
    else:
        path.unlink()
        path.write_bytes(mutated_bytes(source, data, head=HEAD_BYTES))
    return path


def _frames(
    options: WorldOptions, source: random.Random, folder: Path, root: Path, commands: FuzzCommands
) -> FuzzFindings:
    """A sharp frame, and a blurred one that is damaged, to `measure`."""
    found = FuzzFindings()
    [capture, *_] = sorted((folder / "captures").iterdir())
    blurred = min(path for path in capture.iterdir() if path.suffix == ".dng")
    sharp, data = folder / "sharp" / blurred.name, blurred.read_bytes()
    changed = root / "damaged.dng"
    for _ in range(20 if options.quick else 1000):
        changed.write_bytes(mutated_bytes(source, data, head=HEAD_BYTES))
        pair = ("--sharp", changed, blurred) if source.random() < 0.5 else ("--sharp", sharp, changed)
        report = commands.run("measure", *pair, "--out", root / "measured.csv")
        found.add(_described(root, changed, report), report)
    return found


def _described(root: Path, path: Path, report: dict[str, Any]) -> str:
    """A file to try again by hand: kept where its report is not as it must be."""
    lines = report["stderr"].strip().splitlines()
    is_good = report["status"] in {0, 1, 2} and "Traceback" not in report["stderr"]
    if (is_good and (not report["status"] or len(lines) == 1)) or not path.is_file():
        return path.name
    kept = Path(tempfile.gettempdir()) / f"labdaemon-fuzz-{re.sub(r'[^a-z0-9.]+', '-', path.name.lower())}"
    shutil.copy(path, kept)
    return str(kept)


def _link(source: str, target: str) -> None:
    Path(target).hardlink_to(source)
