from __future__ import annotations

import json

from labdaemon.guardian.recipe import PortSetup, StopRecipe, WireExchange, from_json, read_message, to_json
from labdaemon.guardian.wire import is_expected

RECIPE = StopRecipe(
    "shaker", "/dev/ttyUSB0", PortSetup(9600, parity="E", rtscts=True),
    (WireExchange(b"\x02OFF\xff\r"), WireExchange(b"HALT\n", "OK", None, 0.5)), None,
    (WireExchange(b"D?\n", None, 0.02),), b"\r",
)  # fmt: skip


def test_a_recipe_goes_through_json_unchanged():
    assert from_json(json.loads(json.dumps(to_json(RECIPE)))) == RECIPE


def test_a_line_that_was_cut_off_is_no_message():
    assert read_message(b'{"beat": 3, "mov') == {}
    assert read_message(b"[1]") == read_message(b"\xff\x00") == read_message(b"") == {}


def test_what_is_expected():
    switch = WireExchange(b"OUTP?\n", r"0|OFF")
    assert [is_expected(switch, answer) for answer in ("0", "off", "1", "00", "")] == [True, True, False, False, False]
    level = WireExchange(b"VOLT?\n", None, 0.0202)
    answers = ("+2.0E-02", "0.02 VPP", "+1.0E+00", "2.0E-01", "nothing", "nan")
    assert [is_expected(level, answer) for answer in answers] == [True, True, False, False, False, False]
    # a negative number is no small level
    assert not is_expected(level, "-0.5")
