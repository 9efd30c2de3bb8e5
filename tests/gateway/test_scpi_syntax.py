"""Lines of SCPI: what they mean, and that nothing but `ScpiError` comes of any text."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labdaemon.gateway.capture_settings import PARAMETERS, CaptureSettings
from labdaemon.gateway.line_splitter import LONGEST_LINE, LineSplitter
from labdaemon.gateway.scpi_errors import MOST_ERRORS, ErrorQueue, ScpiError, error_of_answer
from labdaemon.gateway.scpi_syntax import (
    HeaderTree,
    block,
    number,
    parse_unit,
    quoted,
    read_flag,
    read_number,
    read_text,
    split_line,
)
from labdaemon.gateway.text_commands import TREE

HERTZ = {"HZ": 1.0, "KHZ": 1e3}


@pytest.mark.parametrize(
    ("line", "units"),
    [
        ("*IDN?", ["*IDN?"]),
        ("CAPT:FREQ 5;AMPL 2;:TRIG", ["CAPT:FREQ 5", "AMPL 2", ":TRIG"]),
        ('CAPT:LAB "a;b";STOP', ['CAPT:LAB "a;b"', "STOP"]),
        (" ; ;; ", []),
        ('CAPT:LAB "say ""no;yes"""', ['CAPT:LAB "say ""no;yes"""']),
    ],
)
def test_lines_are_split_outside_strings(line: str, units: list[str]):
    assert split_line(line) == units


@pytest.mark.parametrize(
    ("text", "header", "is_query", "parameters"),
    [
        ("*idn?", "*idn", True, ()),
        (":SYST:ERR:NEXT?", ":SYST:ERR:NEXT", True, ()),
        ("CAPT:FREQ  5.5 HZ", "CAPT:FREQ", False, ("5.5 HZ",)),
        ("X 1 , 'a,b' ,2", "X", False, ("1", "'a,b'", "2")),
        ('ENV? "P1"', "ENV", True, ('"P1"',)),
    ],
)
def test_a_unit_has_header_and_parameters(text: str, header: str, is_query: bool, parameters: tuple[str, ...]):
    unit = parse_unit(text)
    assert (unit.header, unit.is_query, unit.parameters) == (header, is_query, parameters)


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("\x07TRIG", -101),
        ("TRIG,1", -103),
        ("#TRIG", -101),
        ("TRIG?x", -102),
        ("ABCDEFGHIJKLM", -112),
        ("X 1,,2", -103),
        ("X ,", -103),
        ("?", -102),
        ("TRIG " + ",".join("1" * 20), -108),
    ],
)
def test_what_is_no_unit_has_its_number(text: str, number: int):
    with pytest.raises(ScpiError) as caught:
        parse_unit(text)
    assert caught.value.number == number


@pytest.mark.parametrize(
    "header", ["SYST:ERR", "system:error", "SYST:ERR:NEXT", "System:Error:Next", ":syst:err", "SYSTem:ERRor"]
)
def test_headers_have_a_short_and_a_long_form_and_nothing_between(header: str):
    assert TREE.find(header)[0] is TREE.find("SYST:ERR")[0]


@pytest.mark.parametrize(
    "header", ["SYSTE:ERR", "SYST:ERRO", "SYST", "ERR", "TRIGG", "*IDNX", "SYST:ERR:NEXT:NEXT", "TR"]
)
def test_other_spellings_are_undefined(header: str):
    with pytest.raises(ScpiError) as caught:
        TREE.find(header)
    assert caught.value.number == -113


def test_a_header_is_found_from_the_path_of_the_one_before_or_from_the_root():
    tree = HeaderTree([("CAPTure:FREQuency", "f"), ("CAPTure:LABel", "l"), ("STOP", "s"), ("*OPC", "o")])
    found, path = tree.find("CAPT:FREQ")
    assert (found, path) == ("f", "CAPT:")
    assert tree.find("*opc", path) == ("o", path)
    assert tree.find("LABEL", path) == ("l", "CAPT:")
    assert tree.find("STOP", path)[0] == "s"
    with pytest.raises(ScpiError):
        tree.find(":LABEL", path)


@pytest.mark.parametrize(
    ("text", "value"), [("5", 5.0), ("+5.", 5.0), (".5e1", 5.0), ("5 HZ", 5.0), ("0.005khz", 5.0), ("5E+0 Hz", 5.0)]
)
def test_numbers_may_have_a_unit(text: str, value: float):
    assert read_number(text, HERTZ) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "number"),
    [("5 MM", -131), ("ON", -104), ('"5"', -104), ("5..", -120), ("1e999", -222), ("", -120), ("٥", -120), ("-", -120)],
)
def test_what_is_no_number_has_its_number(text: str, number: int):
    with pytest.raises(ScpiError) as caught:
        read_number(text, HERTZ)
    assert caught.value.number == number


def test_texts_and_flags():
    assert read_text('"a ""b"""') == 'a "b"'
    assert read_text("'a''b'") == "a'b"
    assert read_text("run-7") == "run-7"
    assert [read_flag(word) for word in ("ON", "off", "1", "0", "2.0")] == [True, False, True, False, True]
    for text, wanted in (('"a', -151), ('"', -151), ("a b", -104), ("'a'b'", -151)):
        with pytest.raises(ScpiError) as caught:
            read_text(text)
        assert caught.value.number == wanted


def test_answers_stay_on_one_line():
    assert quoted('a\n"b"\r\0é') == '"a ""b""  \\xe9"'
    assert [number(value) for value in (None, math.nan, 0.5, -1e-9)] == ["9.91E+37", "9.91E+37", "0.5", "-1e-09"]
    assert block(b"x" * 12) == b"#212" + b"x" * 12
    assert block(b"") == b"#10"


@given(st.text(max_size=60))
def test_no_text_raises_anything_but_a_scpi_error(text: str):
    try:
        for part in split_line(text):
            unit = parse_unit(part)
            TREE.find(unit.header)
            for parameter in unit.parameters:
                read_number(parameter, HERTZ)
                read_text(parameter)
    except ScpiError as exc:
        shown = str(exc)
    else:
        shown = ""
    assert shown.isascii()
    assert shown.isprintable()


@given(st.text(st.characters(exclude_characters='\n\r"', codec="ascii"), max_size=60))
def test_a_quoted_text_reads_back(text: str):
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    assert read_text(quoted(text)) == printable


@given(st.lists(st.binary(max_size=40), max_size=20), st.integers(1, 7))
def test_lines_are_the_same_however_their_bytes_come(lines: list[bytes], size: int):
    whole = [line.replace(b"\n", b"").replace(b"\r", b"") for line in lines]
    data = b"".join(line + b"\n" for line in whole)
    splitter, found = LineSplitter(), []
    for start in range(0, len(data), size):
        found += splitter.feed(data[start : start + size])
    assert found == LineSplitter().feed(data)
    assert found == whole


def test_a_line_that_is_too_long_is_dropped_up_to_its_end():
    splitter = LineSplitter()
    assert splitter.feed(b"x" * (LONGEST_LINE + 1)) == []
    assert splitter.feed(b"STOP\nTRIG\n") == [None, b"TRIG"]
    for _ in range(300):
        splitter.feed(b"y" * 4096)
    assert splitter.is_endless


def test_the_error_queue_is_bounded_and_says_so():
    errors = ErrorQueue()
    assert errors.take() == '0,"No error"'
    for place in range(MOST_ERRORS + 5):
        errors.add(ScpiError(-113, f'"{place}"'))
    assert len(errors) == MOST_ERRORS
    assert errors.take() == "-113,\"Undefined header;'0'\""
    assert errors.take_all().endswith('-350,"Queue overflow"')
    assert errors.take_all() == '0,"No error"'


def test_errors_of_the_daemon_have_scpi_numbers():
    assert error_of_answer({"code": -32001, "message": "observers may not"}).number == -203
    assert error_of_answer({"code": -32005, "message": "gone"}).number == -240
    assert error_of_answer({"code": "?"}).number == -300
    assert [ScpiError(number).event_bit for number in (-113, -222, -310, -410)] == [32, 16, 8, 4]


def test_settings_have_units_bounds_and_an_end():
    settings = CaptureSettings()
    for mnemonic, written in {
        "FREQuency": "0.0125 KHZ", "AMPLitude": "500 UM", "PHASe": "180 DEG", "EXPosure": "250 MS",
        "GROup": '"night 1"', "LABel": "'a'", "SHARp": "OFF",
    }.items():  # fmt: skip
        settings.set(PARAMETERS[mnemonic], written)
    assert settings.params() == pytest.approx(
        {"frequency_hz": 12.5, "excitation_amplitude_mm": 0.5, "phase_rad": math.pi, "exposure_s": 0.25}
        | {"group": "night 1", "label": "a", "sharp": False}
    )
    assert settings.query(PARAMETERS["FREQuency"]) == "12.5"
    settings.set(PARAMETERS["FREQuency"], "DEF")
    settings.set(PARAMETERS["LABel"], '""')
    assert settings.query(PARAMETERS["FREQuency"]) == "9.91E+37"
    assert settings.query(PARAMETERS["LABel"]) == '""'
    for mnemonic, written, wanted in (
        ("FREQuency", "0", -222),
        ("EXPosure", "1 H", -131),
        ("LABel", f'"{"x" * 300}"', -223),
    ):
        with pytest.raises(ScpiError) as caught:
            settings.set(PARAMETERS[mnemonic], written)
        assert caught.value.number == wanted
