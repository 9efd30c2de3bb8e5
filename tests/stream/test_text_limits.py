"""Text of a peer, bounded before anything else looks at it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.stream.text_limits import MAX_DEPTH, MAX_DIGITS, bounded_text, is_text, parse_json, surrogate_in

NUMBERS = st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False)


def nested(depth: int, kind: str = "list") -> bytes:
    opening, closing = ("[", "]") if kind == "list" else ('{"a":', "}")
    return (opening * depth + "1" + closing * depth).encode()


@pytest.mark.parametrize("kind", ["list", "dict"])
def test_nesting_is_bounded(kind: str) -> None:
    parse_json(nested(MAX_DEPTH, kind))
    for depth in (MAX_DEPTH + 1, 100_000):
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_json(nested(depth, kind))


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity"])
def test_constants_that_json_lacks_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no JSON number"):
        parse_json(f'{{"x": {text}}}'.encode())


@pytest.mark.parametrize(("text", "words"), [
    ("1" * (MAX_DIGITS + 1), "digits"), ("0." + "1" * MAX_DIGITS, "digits"), ("1e400", "out of range"),
    ("-1e999", "out of range"),
])  # fmt: skip
def test_numbers_are_bounded(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(text.encode())


def test_a_long_whole_number_is_kept_exactly() -> None:
    assert parse_json(b"9" * MAX_DIGITS) == int("9" * MAX_DIGITS)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.recursive(
        st.none() | st.booleans() | NUMBERS | st.text(),
        lambda part: st.lists(part, max_size=4) | st.dictionaries(st.text(), part, max_size=4),
        max_leaves=12,
    )
)  # fmt: skip
def test_ordinary_json_is_parsed_as_ever(value: Any) -> None:
    text = json.dumps(value).encode()
    assert parse_json(text) == json.loads(text)


@pytest.mark.parametrize(("value", "where"), [
    ("plain", None), ("\ud800", ""), ({"label": "\udc00"}, "label"), ({"\ud800": 1}, "a name"),
    ({"notes": ["a", "\ud800"]}, "notes.[1]"), ([["\ud800"]], "[0].[0]"), ({"a": {"b": {"c": "ok"}}}, None),
    (7, None), (None, None),
])  # fmt: skip
def test_half_a_pair_is_found_wherever_it_is(value: Any, where: str | None) -> None:
    assert surrogate_in(value) == where


def test_what_is_text_can_be_written() -> None:
    assert is_text("Brücke 振動 \U0001f3d7")
    assert not is_text("\ud83c")


@pytest.mark.parametrize(("value", "longest", "expected"), [
    ("short", 40, "short"), ("x" * 50, 5, "xxxxx"), (["a", 1], 40, "['a', 1]"), ("ä\ud800", 40, "\\xe4\\ud800"),
])  # fmt: skip
def test_a_peers_value_is_short_and_text_in_a_message(value: Any, longest: int, expected: str) -> None:
    assert bounded_text(value, longest) == expected


def test_a_number_of_thousands_of_digits_has_a_text() -> None:
    assert bounded_text(10**5000) == "a int"


def test_a_list_within_itself_has_a_text() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    assert bounded_text(deep) == "a list"
