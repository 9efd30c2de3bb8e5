"""Labels of manual captures as parts of file names, on any system."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.campaign.manual_request import LONGEST_NAME_BYTES, RESERVED, capture_name, is_group_name, safe_name


@pytest.mark.parametrize(("label", "expected"), [
    ("crack 7", "crack 7"),
    ("Riß 7 / left", "Riß 7 - left"),
    ("  much   room ", "much room"),
    ("..", ""),
    ("../../etc/passwd", "-..-etc-passwd"),
    ("tab\tand\nline", "tab-and-line"),
    ("振動 3", "振動 3"),
    ("50 % $HOME `ls`", "50 - -HOME -ls-"),
    ("", ""),
])  # fmt: skip
def test_labels_become_names(label: str, expected: str) -> None:
    assert safe_name(label) == expected


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.text(max_size=300))
def test_a_name_is_safe_whatever_the_label(label: str) -> None:
    name = safe_name(label)
    assert not set(name) & RESERVED
    assert all(letter.isprintable() for letter in name)
    assert len(name.encode("utf-8", "replace")) <= LONGEST_NAME_BYTES
    assert not name.startswith((" ", "."))
    assert not name.endswith((" ", "."))
    assert safe_name(name) == name, "a safe name stays"


def test_composed_and_decomposed_letters_are_one_name() -> None:
    assert safe_name(unicodedata.normalize("NFD", "Brücke")) == safe_name("Brücke")


def test_a_long_label_is_cut_between_letters() -> None:
    name = safe_name("ä" * 100)
    assert name == "ä" * (LONGEST_NAME_BYTES // 2)


def test_the_number_makes_a_name_unique_and_sorts_it() -> None:
    assert capture_name(7, "crack-7") == "manual-000007-crack-7"
    assert capture_name(8, "/") == "manual-000008--"
    assert capture_name(9, "") == "manual-000009"
    assert sorted([capture_name(10, "a"), capture_name(9, "b")]) == [capture_name(9, "b"), capture_name(10, "a")]


@pytest.mark.parametrize(("name", "is_one"), [
    ("bolt A", True), ("", False), ("a/b", False), (".hidden", False), (" bolt", False), ("bolt.", False),
    ("ä" * 100, False),
])  # fmt: skip
def test_a_group_is_named_as_it_stands(name: str, is_one: bool) -> None:
    assert is_group_name(name) is is_one
