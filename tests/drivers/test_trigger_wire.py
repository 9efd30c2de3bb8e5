"""The trigger box's line protocol: a reply counts only with the right checksum."""

from __future__ import annotations

import binascii

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdrivers.trigger_wire import LAST_SEQUENCE, decode, encode

WORDS = st.lists(st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-.", min_size=1, max_size=12), min_size=1, max_size=8)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(sequence=st.integers(1, LAST_SEQUENCE), words=WORDS, start=st.sampled_from("<>"))
def test_what_is_sent_is_read(sequence: int, words: list[str], start: str) -> None:
    line = encode(start, sequence, " ".join(words))
    assert line.endswith(b"\n")
    found = decode(start, line)
    assert found is not None
    assert (found.sequence, found.words) == (sequence, tuple(words))
    assert decode("<" if start == ">" else ">", line) is None, "an echo is no reply"


@settings(max_examples=60, deadline=None, derandomize=True)
@given(sequence=st.integers(1, LAST_SEQUENCE), words=WORDS, place=st.integers(0, 200), bit=st.integers(0, 7))
def test_one_wrong_bit_is_noticed(sequence: int, words: list[str], place: int, bit: int) -> None:
    """CRC-16 finds every single wrong bit; a spoilt checksum may only change the case of its digits."""
    line = bytearray(encode("<", sequence, " ".join(words))[:-1])
    line[place % len(line)] ^= 1 << bit
    found = decode("<", bytes(line))
    if found is not None:
        assert (found.sequence, found.words) == (sequence, tuple(words))
        assert bytes(line).upper() == encode("<", sequence, " ".join(words))[:-1].upper()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.binary(max_size=60))
def test_rubbish_is_no_message(line: bytes) -> None:
    found = decode("<", b"<" + line)
    assert found is None or found.words is not None


@pytest.mark.parametrize(
    "line", [b"", b"<", b"<1 OK", b"<1 OK*12", b"<1 OK*XXXX", b"<1 OK*00000", b"<*0000", b"<x OK*"]
)
def test_halves_of_messages_are_none(line: bytes) -> None:
    assert decode("<", line) is None


def test_the_checksum_is_xmodems() -> None:
    """So that firmware in another language can be checked against one number: "123456789" gives 31C3."""
    assert binascii.crc_hqx(b"123456789", 0) == 0x31C3
    assert encode(">", 7, "ID") == f">7 ID*{binascii.crc_hqx(b'7 ID', 0):04X}\n".encode()
