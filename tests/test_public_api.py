"""The public names and their types: what notebooks and other programs rely on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import labdaemon as ld

PUBLIC = {
    "Client",
    "Envelope",
    "ExposureWindow",
    "Flag",
    "LabdaemonError",
    "Measurement",
    "MotionTable",
    "ProcessedFolder",
    "RawFrame",
    "TargetEnvelope",
    "__version__",
    "errors",
    "flags",
    "frame_from_array",
    "measure",
    "process",
    "read_frame",
}

USE = """
from pathlib import Path
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import labdaemon as ld

motion = ld.measure(Path("sharp.nef"), "blurred.nef", window=ld.ExposureWindow(5.0, 1.0))
assert_type(motion, ld.MotionTable)
assert_type(motion["T01"], ld.Measurement)
assert_type(motion["T01"].amplitude_px, float)
assert_type(motion["T01"].sd_px, float)
assert_type(motion["T01"].flags, frozenset[ld.Flag])
assert_type(ld.frame_from_array(np.zeros((40, 40), np.uint16)), ld.RawFrame)
result = ld.process("FOLDER")
assert_type(result["c1"], ld.Envelope)
assert_type(result["c1"]["T01"].amplitude_mm, float)
assert_type(result["c1"].to_array(), NDArray[np.void])
"""


def test_public_names_are_these() -> None:
    assert set(ld.__all__) >= PUBLIC
    for name in ld.__all__:
        assert getattr(ld, name) is not None


@pytest.mark.slow
def test_public_types_are_these(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="mypy is not installed")
    program = tmp_path / "use.py"
    program.write_text(USE, encoding="utf-8")
    config = Path(__file__).parents[1] / "pyproject.toml"
    command = [sys.executable, "-m", "mypy", "--config-file", str(config), "--strict", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=config.parent)
    assert done.returncode == 0, done.stdout + done.stderr


def test_packages_have_faces_whose_names_exist() -> None:
    for package in ("analysis", "blur", "geometry", "imaging", "processing", "testing"):
        module = __import__(f"labdaemon.{package}", fromlist=["__all__"])
        for name in module.__all__:
            assert getattr(module, name) is not None, f"labdaemon.{package}.{name}"
