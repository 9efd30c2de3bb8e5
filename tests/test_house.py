"""The house rules that a machine can hold: lint, format, types, and imports that only go down."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def run(*command: str) -> None:
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"


def tool(name: str) -> str:
    path = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


def test_ruff_finds_nothing() -> None:
    run(tool("ruff"), "check", ".")


def test_format_is_ruffs() -> None:
    run(tool("ruff"), "format", "--check", ".")


@pytest.mark.slow
def test_types_hold() -> None:
    run(tool("mypy"))


def test_imports_only_go_down() -> None:
    run(tool("lint-imports"))
