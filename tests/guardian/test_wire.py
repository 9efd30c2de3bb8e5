"""The guardian's way with a shaker's port: what is sent, what counts as rest, and what is said of a silent wire."""

from __future__ import annotations

from collections import deque

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.guardian import wire
from labdaemon.guardian.recipe import PortSetup, StopRecipe, WireExchange
from labdaemon.guardian.wire import CONFIRM_TRIES, StopFailure, is_expected, stop_shaker

STOP = WireExchange(b"OUTP OFF\n")
IDENTIFY = WireExchange(b"*IDN?\n", within_s=0.2)
CONFIRM = WireExchange(b"OUTP?\n", "0|OFF", within_s=0.2)
RECIPE = StopRecipe("shaker", "/dev/ttyUSB0", PortSetup(), (STOP,), IDENTIFY, (CONFIRM,))


class FakePort:
    """A shaker's controller: an answer for each line, and what was sent."""

    def __init__(self, answers: dict[bytes, bytes | list[bytes]]) -> None:
        self.answers = {line: deque(one) if isinstance(one, list) else one for line, one in answers.items()}
        self.sent: list[bytes] = []
        self.is_closed = False
        self.output = b""

    def read(self, size: int = 1) -> bytes:
        taken, self.output = self.output[:size], self.output[size:]
        return taken

    def write(self, data: bytes, /) -> int:
        self.sent.append(data)
        answer = self.answers.get(data, b"")
        if isinstance(answer, deque):
            answer = answer.popleft() if len(answer) > 1 else answer[0]
        self.output += answer
        return len(data)

    def close(self) -> None:
        self.is_closed = True


def stop(port: FakePort, recipe: StopRecipe = RECIPE) -> None:
    stop_shaker(recipe, lambda _: port, sleep=lambda _: None)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire, "QUIET_S", 0.001)
    monkeypatch.setattr(wire, "LONGEST_DRAIN_S", 0.01)


QUESTIONS = {"identify": b"*IDN?\n", "confirm": b"OUTP?\n"}


def resting(**answers: bytes | list[bytes]) -> FakePort:
    """A controller whose output is off; other answers to the questions by name."""
    return FakePort(
        {b"*IDN?\n": b"KEYSIGHT,33500\n", b"OUTP?\n": b"0\n"} | {QUESTIONS[name]: one for name, one in answers.items()}
    )


def test_the_stop_is_sent_first_and_rest_is_seen_twice() -> None:
    port = resting()
    stop(port)
    assert port.sent[0] == b"OUTP OFF\n"
    assert port.sent.count(b"OUTP?\n") == 2
    assert port.is_closed


def test_what_is_not_at_rest_is_stopped_again() -> None:
    port = resting(confirm=[b"1\n", b"0\n"])
    stop(port)
    assert port.sent.count(b"OUTP OFF\n") == 2


def test_a_shaker_that_keeps_its_output_on_is_no_rest() -> None:
    port = resting(confirm=b"1\n")
    with pytest.raises(StopFailure, match="'1' to b'OUTP\\?\\\\n', which is not rest"):
        stop(port)
    assert port.sent.count(b"OUTP OFF\n") == 1 + CONFIRM_TRIES
    assert port.is_closed


@pytest.mark.parametrize("silent", ["identify", "confirm"])
def test_a_silent_wire_is_no_rest(silent: str) -> None:
    with pytest.raises(StopFailure, match="no answer on /dev/ttyUSB0"):
        stop(resting(**{silent: b""}))


def test_a_late_answer_to_the_dead_daemon_is_not_taken_for_rest() -> None:
    """The first answer to the identity question is the daemon's last one; asking goes on until two are the same."""
    port = resting(identify=[b"+0,No error\n", b"KEYSIGHT,33500\n"])
    stop(port)
    assert port.sent.count(b"*IDN?\n") >= 3


@pytest.mark.parametrize("late", [b"0\n" * n for n in (1, 2, 3, 4, 8)] + [b"KEYSIGHT,33500\n" * 2 + b"0\n" * 2])
def test_no_row_of_late_answers_passes_for_name_and_rest(late: bytes) -> None:
    """They were held up on the way, and come when the wire has been read away already; the output is still on."""
    port = resting(identify=[late + b"KEYSIGHT,33500\n", b"KEYSIGHT,33500\n"], confirm=b"1\n")
    with pytest.raises(StopFailure):
        stop(port)


def test_answers_that_never_agree_are_out_of_step() -> None:
    port = resting(identify=[f"late {number}\n".encode() for number in range(20)])
    with pytest.raises(StopFailure, match="out of step"):
        stop(port)


def test_acknowledgements_of_the_stop_are_no_name() -> None:
    recipe = RECIPE._replace(stop=(WireExchange(b"OUTP OFF\n", "ok"),))
    port = resting(identify=[b"OK\nKEYSIGHT\n", b"KEYSIGHT\n"])
    stop(port, recipe)


def test_rubbish_before_the_answer_is_passed_over() -> None:
    """Empty lines, zeros of a break, and a line without an end that would fill the memory."""
    port = resting(confirm=b"\n\x00\r\n0\n")
    stop(port)


@pytest.mark.parametrize("error", [serial.SerialException("gone"), OSError(5, "I/O"), TypeError("of pyserial's own")])
def test_a_port_that_goes_is_said_in_words(error: Exception) -> None:
    def refuse(_: StopRecipe) -> FakePort:
        raise error

    with pytest.raises(StopFailure, match="does not open"):
        stop_shaker(RECIPE, refuse)

    class GonePort(FakePort):
        def read(self, size: int = 1) -> bytes:
            raise error

        def close(self) -> None:
            raise error

    with pytest.raises(StopFailure, match="connection on /dev/ttyUSB0 lost"):
        stop(GonePort({}))


@pytest.mark.parametrize(("exchange", "answer", "expected"), [
    (WireExchange(b"", None), "anything", True),
    (WireExchange(b"", "0|OFF"), "off", True),
    (WireExchange(b"", "0|OFF"), "OFFICE", False),
    (WireExchange(b"", None, at_most=0.01), "+5.0E-3 V", True),
    (WireExchange(b"", None, at_most=0.01), "-0.02", False),
    (WireExchange(b"", None, at_most=0.01), "no number", False),
    (WireExchange(b"", r"LEVEL .*", at_most=0.0), "level 0.000", True),
    (WireExchange(b"", r"LEVEL .*", at_most=0.0), "level 0.001", False),
])  # fmt: skip
def test_answers_that_mean_rest(exchange: WireExchange, answer: str, expected: bool) -> None:
    assert is_expected(exchange, answer) is expected


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.text(max_size=30))
def test_no_answer_at_all_makes_the_judgement_fail(answer: str) -> None:
    for exchange in (CONFIRM, WireExchange(b"", None, at_most=1.0)):
        assert is_expected(exchange, answer) in {True, False}


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.lists(st.binary(min_size=1, max_size=20), min_size=1, max_size=6))
def test_rubbish_is_never_rest(chunks: list[bytes]) -> None:
    """Whatever a broken wire sends, the table is at rest only by the expected answer."""
    port = resting(
        confirm=[chunk.replace(b"0", b"x").replace(b"F", b"x").replace(b"f", b"x") + b"\n" for chunk in chunks]
    )
    with pytest.raises(StopFailure):
        stop(port)
