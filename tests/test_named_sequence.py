"""Elements by position and by name."""

from __future__ import annotations

import pytest

from labdaemon.named_sequence import NamedSequence


class Words(NamedSequence[str]):
    """Words, named by their first letter."""

    def __init__(self, *words: str) -> None:
        self._words = words

    def _elements(self) -> tuple[str, ...]:
        return self._words

    def _name_of(self, element: str) -> str:
        return element[0]

    def _missing(self, name: str) -> str:
        return f"no word begins with {name!r}"


WORDS = Words("alpha", "beta", "bravo")


def test_it_is_a_sequence() -> None:
    assert (len(WORDS), WORDS[0], WORDS[-1], list(WORDS)) == (3, "alpha", "bravo", ["alpha", "beta", "bravo"])
    assert WORDS[1:] == ("beta", "bravo")
    assert "beta" in WORDS
    assert list(reversed(WORDS)) == ["bravo", "beta", "alpha"]
    with pytest.raises(IndexError):
        WORDS[3]


def test_a_name_finds_the_first_of_it() -> None:
    assert WORDS["b"] == "beta"


def test_a_name_that_is_not_there_says_what_is_missing() -> None:
    with pytest.raises(KeyError, match="no word begins with 'z'"):
        WORDS["z"]
