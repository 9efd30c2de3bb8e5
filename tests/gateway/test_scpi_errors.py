"""Errors as SCPI-1999 numbers them, and the queue in which a client finds them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.gateway import scpi_errors
from labdaemon.gateway.scpi_errors import MOST_ERRORS, ErrorQueue, ScpiError, error_of_answer
from labdaemon.stream import messages


@pytest.mark.parametrize(("number", "bit"), [
    (-113, scpi_errors.COMMAND_ERROR), (-222, scpi_errors.EXECUTION_ERROR), (-310, scpi_errors.DEVICE_ERROR),
    (-410, scpi_errors.QUERY_ERROR), (-350, scpi_errors.DEVICE_ERROR), (-100, scpi_errors.COMMAND_ERROR),
])  # fmt: skip
def test_the_event_bit_follows_the_hundreds(number: int, bit: int) -> None:
    assert ScpiError(number).event_bit == bit


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.sampled_from(list(scpi_errors.TEXTS)), st.text(max_size=600))
def test_an_error_is_one_line_of_ascii_within_the_standards_length(number: int, detail: str) -> None:
    text = str(ScpiError(number, detail))
    assert text.startswith(f'{number},"{scpi_errors.TEXTS[number]}')
    assert text.isascii()
    assert text.count('"') == 2
    assert "\n" not in text or "\n" in detail


def test_every_code_of_a_command_has_a_number_of_the_standard() -> None:
    for code in messages.NAMES:
        error = error_of_answer({"code": code, "message": "no"})
        assert error.number in scpi_errors.TEXTS
        assert error.detail == "no"
    assert error_of_answer({"code": "x"}).number == -300
    assert error_of_answer({}).detail == ""


def test_the_oldest_error_comes_first_and_none_is_an_answer_too() -> None:
    queue = ErrorQueue()
    assert queue.take() == '0,"No error"'
    queue.add(ScpiError(-113))
    queue.add(ScpiError(-222, "too fast"))
    assert len(queue) == 2
    assert queue.take() == '-113,"Undefined header"'
    assert queue.take_all() == '-222,"Data out of range;too fast"'
    assert queue.take_all() == '0,"No error"'


def test_a_full_queue_says_that_there_were_more() -> None:
    queue = ErrorQueue()
    for number in range(3 * MOST_ERRORS):
        queue.add(ScpiError(-222, str(number)))
    assert len(queue) == MOST_ERRORS
    everything = queue.take_all().split(",-")
    assert everything[-1].startswith("350,")
    assert len(queue) == 0
    queue.add(ScpiError(-113))
    queue.clear()
    assert queue.take() == '0,"No error"'
