"""The house rules that a machine can hold: lint, format, types, imports that only go down, and figures of the code."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]

MODULE_LINES_MEDIAN, MODULE_LINES_MAX = 150, 400
LONG_FUNCTIONS_MAX = 0.01
"""Share of functions of more than 60 lines."""
MOCKS_MAX = 10
TESTS_PER_CODE_MIN = 0.6
COMMENTS_MIN = 0.025
"""Share of code lines; lines are counted as `house_figures.LineCounts` says."""
IDIOMS_PER_1000_MAX = 2.0
"""Hits of words that readers of other languages misread, in code and documentation."""


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


@pytest.fixture(scope="module")
def figures() -> Any:
    """Figures of `house_figures.py`, a script of no package, loaded from its file."""
    spec = importlib.util.spec_from_file_location("house_figures", Path(__file__).with_name("house_figures.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclass looks its own module up
    spec.loader.exec_module(module)
    return module.measure()


def test_everything_is_annotated(figures: Any) -> None:
    assert figures.annotated == 1.0


def test_modules_are_short(figures: Any) -> None:
    assert median(figures.module_lines) <= MODULE_LINES_MEDIAN
    assert max(figures.module_lines) <= MODULE_LINES_MAX


def test_functions_are_short(figures: Any) -> None:
    assert figures.long_functions <= LONG_FUNCTIONS_MAX


def test_fakes_stand_in_for_mocks(figures: Any) -> None:
    assert figures.mocks <= MOCKS_MAX


def test_there_are_enough_tests(figures: Any) -> None:
    assert figures.test_lines >= TESTS_PER_CODE_MIN * figures.code_lines


def test_comments_say_why(figures: Any) -> None:
    assert figures.comments >= COMMENTS_MIN


def test_public_attributes_state_their_types(figures: Any) -> None:
    """What `pyright --verifytypes labdaemon --ignoreexternal` calls ambiguous; it finds 99 % and more known."""
    assert figures.unannotated == []


def test_words_are_the_fields(figures: Any) -> None:
    assert figures.idioms_per_1000 <= IDIOMS_PER_1000_MAX, "\n".join(figures.idioms)


def test_class_names_are_nouns_and_stand_for_one_thing(figures: Any) -> None:
    assert figures.participles == []
    assert figures.repeated_classes == []
