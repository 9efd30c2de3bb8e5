"""Wheel and sdist hold what a user needs: the packages, config, systemd units, docs and examples."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build both from the files that git knows, with the build backend of this environment."""
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.slow
def test_wheel_has_both_packages_and_no_tests(built: Path) -> None:
    [wheel] = built.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in ("labdaemon/__init__.py", "labdaemon/py.typed", "labdrivers/scpi.py", "labdrivers/sim/server.py"):
        assert wanted in names
    assert not [name for name in names if name.startswith(("tests/", "docs/", "drivers/"))]
    for wanted in ("config/lab.toml", "systemd/labdaemon@.service", "docs/explanation/method.md"):
        assert [name for name in names if name.endswith(f".data/data/share/labdaemon/{wanted}")]
    metadata = zipfile.ZipFile(wheel).read(next(n for n in names if n.endswith("METADATA"))).decode()
    assert "Requires-Dist: pyserial" in metadata
    assert "License-Expression: BSD-3-Clause" in metadata


@pytest.mark.slow
def test_sdist_has_what_an_installation_needs(built: Path) -> None:
    [sdist] = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for wanted in (
        "config/lab.toml",
        "config/campaigns/three-modes.toml",
        "systemd/labdaemon@.service",
        "docs/explanation/method.md",
        "examples/two_photographs.py",
        "CITATION.cff",
        "CONTRIBUTING.md",
        "LICENSE",
    ):
        assert wanted in names
    assert not [name for name in names if name.endswith((".pyc", ".dng", ".nef"))]
