"""Bytes of a client to lines, bounded whatever it sends."""

from __future__ import annotations

import asyncio
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.clock import SimulatedClock
from labdaemon.gateway.line_splitter import LONGEST_LINE, MOST_WITHOUT_END, LineSplitter
from labdaemon.stream.pace import Pace


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.lists(st.binary(max_size=20).map(lambda line: b"x" + b"".join(line.splitlines())), max_size=6), st.data())
def test_lines_come_whole_however_the_bytes_are_cut(lines: list[bytes], data: st.DataObject) -> None:
    text = b"".join(line + data.draw(st.sampled_from([b"\n", b"\r\n", b"\r"])) for line in lines)
    cuts = sorted({*data.draw(st.lists(st.integers(0, len(text)), max_size=5)), 0, len(text)})
    splitter = LineSplitter()
    assert [line for a, b in pairwise(cuts) for line in splitter.feed(text[a:b])] == lines
    assert not splitter.is_endless


def test_a_line_of_the_longest_length_is_one_and_a_longer_one_is_named_as_such() -> None:
    splitter = LineSplitter()
    assert splitter.feed(b"x" * LONGEST_LINE + b"\n") == [b"x" * LONGEST_LINE]
    assert splitter.feed(b"x" * (LONGEST_LINE + 1) + b"\n*IDN?\n") == [None, b"*IDN?"]


def test_a_long_line_in_many_parts_is_dropped_up_to_its_end() -> None:
    splitter = LineSplitter()
    for _ in range(10):
        assert splitter.feed(b"x" * 1000) == []
    assert splitter.feed(b"x\n*IDN?\n") == [None, b"*IDN?"]


def test_a_peer_that_never_ends_a_line_is_noticed_and_costs_no_memory() -> None:
    splitter = LineSplitter()
    for _ in range(MOST_WITHOUT_END // 65536 + 2):
        splitter.feed(b"\0" * 65536)
    assert splitter.is_endless
    assert len(splitter._line) <= LONGEST_LINE


@pytest.mark.parametrize(("units", "expected_s"), [([5.0], 0.0), ([10.0, 10.0], 2.0), ([30.0], 4.0), ([1.0] * 30, 4.0)])
def test_a_burst_is_free_and_the_rest_takes_its_time(units: list[float], expected_s: float) -> None:
    """Five units a second, ten at once."""
    clock = SimulatedClock()

    async def scenario() -> None:
        pace = Pace(5.0, 10.0)
        for one in units:
            await pace.take(one)

    clock.run(scenario())
    assert clock.monotonic() == pytest.approx(expected_s, abs=0.01)


def test_who_waits_is_served_in_order() -> None:
    clock, served = SimulatedClock(), []

    async def scenario() -> None:
        pace = Pace(1.0, 1.0)

        async def take(name: str) -> None:
            await pace.take(2.0)
            served.append(name)

        await asyncio.gather(*(take(name) for name in "abc"))

    clock.run(scenario())
    assert served == ["a", "b", "c"]
    assert clock.monotonic() == pytest.approx(5.0)
