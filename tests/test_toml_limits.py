"""TOML that costs more to parse than any rig or campaign is refused before it is parsed."""

from __future__ import annotations

import contextlib
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.errors import ConfigError
from labdaemon.toml_limits import MAX_DEPTH, MAX_DOTS, MAX_KEYS, MAX_WORD, check_toml

CONFIG = Path(__file__).parents[1] / "config"


@pytest.mark.parametrize("path", sorted(CONFIG.rglob("*.toml")), ids=lambda path: path.name)
def test_our_own_files_pass(path: Path) -> None:
    check_toml(path.read_text())


@pytest.mark.parametrize(("text", "words"), [
    (".".join("a" * (MAX_DOTS + 2)) + " = 1", f"more than {MAX_DOTS} dots"),
    ("a = " + "[" * (MAX_DEPTH + 1), f"more than {MAX_DEPTH} brackets"),
    ("a = " + "{b=" * (MAX_DEPTH + 1), f"more than {MAX_DEPTH} brackets"),
    ("a = " + "9" * (MAX_WORD + 1), f"more than {MAX_WORD} characters"),
    ("a = 1\n" * (MAX_KEYS + 1), f"more than {MAX_KEYS} keys"),
])  # fmt: skip
def test_too_much_is_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        check_toml(text)


def test_the_line_and_the_file_are_named() -> None:
    with pytest.raises(ConfigError, match=r"^rig\.toml: .*\(at line 3\)"):
        check_toml("a = 1\nb = 2\nc = " + "9" * 300, source="rig.toml")


@pytest.mark.parametrize("text", [
    'a = "' + "." * 100 + '"',
    "a = '" + "[" * 100 + "'",
    'a = """\n' + "[" * 100 + '\n"""',
    "# " + "[." * 100 + "\na = 1",
    'a = "' + "9" * 1000 + '"',
    'a = "\\"[[[[[[[[[[[[[[[[[[[[["',
])  # fmt: skip
def test_strings_and_comments_count_for_nothing(text: str) -> None:
    check_toml(text)
    tomllib.loads(text)


def test_dots_are_of_one_key() -> None:
    check_toml("\n".join(f"a{number}.b.c.d = 1.5" for number in range(100)))
    check_toml("a = [" + ", ".join(["1.5"] * 100) + "]")


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.text(alphabet="ab1.=[]{}\"'#\n\\ ,", max_size=60))
def test_whatever_is_written_is_scanned_to_its_end(text: str) -> None:
    """No text makes the scan itself fail: only its own refusal comes out."""
    with contextlib.suppress(ConfigError):
        check_toml(text)
