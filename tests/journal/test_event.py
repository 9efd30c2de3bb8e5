"""Events as they are kept and sent."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.journal.event import EventText, StoredEvent, event_text, limit_bytes

AT = "2026-05-04T10:11:12.000000Z"
NUMBERS = st.integers(-(2**40), 2**40) | st.floats(allow_nan=False, allow_infinity=False)
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(),
    lambda part: st.lists(part, max_size=3) | st.dictionaries(st.text(), part, max_size=3),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=40, deadline=None, derandomize=True)
@given(data=st.dictionaries(st.text(), JSON, max_size=4), campaign=st.none() | st.text(), seq=st.integers(1, 2**50))
def test_both_ways_to_json_say_the_same(data: dict[str, object], campaign: str | None, seq: int) -> None:
    """The payload that is never parsed on its way reads as the one that is."""
    event = StoredEvent(seq, AT, "fault", campaign, data, "uuid")
    travelling = event_text((seq, AT, "fault", campaign, json.dumps(data)), "uuid")
    assert json.loads(travelling.json) == json.loads(event.to_json()) == event.as_dict()
    assert (travelling.seq, travelling.kind) == (seq, "fault")


def test_a_number_that_json_lacks_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        StoredEvent(1, AT, "fault", None, {"x": float("nan")}, "uuid").text()


def texts(*sizes: int) -> list[EventText]:
    return [EventText(number, "fault", b"x" * size) for number, size in enumerate(sizes)]


@pytest.mark.parametrize(("sizes", "most", "taken"), [
    ((10, 10, 10), 30, 3), ((10, 10, 10), 29, 2), ((100, 1), 10, 1), ((), 10, 0), ((10, 100, 1), 20, 1),
])  # fmt: skip
def test_an_answer_is_bounded_but_never_empty(sizes: tuple[int, ...], most: int, taken: int) -> None:
    """One event larger than the bound must come all the same, or its reader would never get on."""
    assert [one.seq for one in limit_bytes(texts(*sizes), most)] == list(range(taken))


def test_no_more_is_read_than_is_sent() -> None:
    read = []

    def rows() -> Iterator[EventText]:
        for text in texts(*[10] * 100):
            read.append(text.seq)
            yield text

    limit_bytes(rows(), 25)
    assert read == [0, 1, 2]
