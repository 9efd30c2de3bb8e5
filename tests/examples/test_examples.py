"""Every example runs, and shows what it says."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from labdaemon.capture.devices import Gauge
from labdaemon.errors import TransportError

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    return module


def test_dot_from_arrays_agrees_with_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    dot = load(EXAMPLES / "dot_from_arrays.py", monkeypatch).main(3.0)
    assert abs(dot.amplitude_px - 3.0) < max(4 * dot.sd_px, 0.03)
    assert not dot.flags


def test_two_photographs_prints_a_line_per_dot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dot_image = load(EXAMPLES / "dot_from_arrays.py", monkeypatch).dot_image
    rng = np.random.default_rng(2)
    for name, amplitude in (("sharp", 0.0), ("blurred", 5.0)):
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), dot_image(amplitude, rng) * 16)
    command = [sys.executable, str(EXAMPLES / "two_photographs.py")]
    done = subprocess.run(
        [*command, str(tmp_path / "sharp.png"), str(tmp_path / "blurred.png")], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "1 targets, 1 without flags" in done.stdout
    assert "T01  at" in done.stdout
    assert done.stdout.rstrip().endswith("ok")


def test_the_notebook_runs_from_top_to_bottom(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    monkeypatch.syspath_prepend(str(EXAMPLES))
    book = json.loads((EXAMPLES / "measure.ipynb").read_text(encoding="utf-8"))
    names: dict[str, object] = {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        for cell in book["cells"]:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), names)
    assert re.search(r"true  4.00 px   measured  (4\.0|3\.99)", printed.getvalue())
    assert all(not cell.get("outputs") for cell in book["cells"]), "the notebook is kept without outputs"


def test_the_campaign_passes_the_plan() -> None:
    command = [sys.executable, "-m", "labdaemon", "plan", str(EXAMPLES / "stepped_sine.toml")]
    done = subprocess.run(
        [*command, "--config", str(ROOT / "config" / "sim.toml")], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert "6 steps, 13 captures" in done.stdout


def test_the_driver_reads_its_simulator_on_a_wire(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = load(EXAMPLES / "my_laser" / "my_laser.py", monkeypatch)
    simulator = load(EXAMPLES / "my_laser" / "laser_simulator.py", monkeypatch)
    with simulator.LaserSimulator(1.5, 8.0) as laser:
        gauge = driver.MyLaser("table", {"port": laser.port, "role": "table"})
        assert isinstance(gauge, Gauge)
        assert laser.port in gauge.connect()
        reading = gauge.read(8.0, duration_s=0.5)
        gauge.close()
    assert abs(reading.value - 1.5) < 0.001
    assert reading.sd < 0.001
    unplugged = driver.MyLaser("table", {"port": laser.port, "role": "table"})
    with pytest.raises(TransportError, match="check the cable"):
        unplugged.connect()
