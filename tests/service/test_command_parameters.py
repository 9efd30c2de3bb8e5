"""A command's parameters: known, of the right type and size, or refused by name."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.service.capture_parameters import capture_request
from labdaemon.service.command_parameters import CommandParameters
from labdaemon.stream.messages import InvalidParamsError


def test_an_unknown_name_is_refused_with_what_was_meant() -> None:
    with pytest.raises(InvalidParamsError, match="did you mean exposure_s"):
        CommandParameters({"exposur_s": 1}, "exposure_s", "label")
    with pytest.raises(InvalidParamsError, match="known are exposure_s, label"):
        CommandParameters({"zzz": 1}, "exposure_s", "label")
    with pytest.raises(InvalidParamsError, match="known are none"):
        CommandParameters({"zzz": 1})


@pytest.mark.parametrize(("value", "expected"), [("night", "night"), (None, "def"), ("", "")])
def test_a_text_or_its_default(value: str | None, expected: str) -> None:
    assert CommandParameters({"x": value}, "x").text("x", longest=5, default="def") == expected
    assert CommandParameters({}, "x").text("x", longest=5, default="def") == "def"
    assert CommandParameters({}, "x").optional_text("x", longest=5) is None


@pytest.mark.parametrize("value", ["toolong", 3, True, ["a"], {}])
def test_what_is_no_text_or_too_long_is_refused(value: Any) -> None:
    given_ = CommandParameters({"x": value}, "x")
    with pytest.raises(InvalidParamsError, match="x is a text of at most 5 characters"):
        given_.text("x", longest=5)
    with pytest.raises(InvalidParamsError, match="at most 5"):
        given_.optional_text("x", longest=5)


def test_a_text_without_default_must_be_there() -> None:
    with pytest.raises(InvalidParamsError, match="x is a text"):
        CommandParameters({}, "x").text("x", longest=5)


@pytest.mark.parametrize(("value", "expected"), [(True, True), (False, False), (None, False)])
def test_a_flag(value: bool | None, expected: bool) -> None:
    assert CommandParameters({"x": value}, "x").flag("x") is expected


@pytest.mark.parametrize("value", [1, 0, "true", []])
def test_what_is_no_flag_is_refused(value: Any) -> None:
    with pytest.raises(InvalidParamsError, match="x is true or false, not"):
        CommandParameters({"x": value}, "x").flag("x")


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(allow_nan=True) | st.integers(-(10**30), 10**30))
def test_a_number_is_within_its_bounds_or_refused(value: float) -> None:
    given_ = CommandParameters({"x": value}, "x")
    if not math.isnan(value) and 1.0 <= value <= 100.0:
        assert given_.number("x", least=1.0, most=100.0) == float(value)
    else:
        with pytest.raises(InvalidParamsError, match="x is a number from 1 to 100"):
            given_.number("x", least=1.0, most=100.0)


@pytest.mark.parametrize("value", [True, "5", [5]])
def test_what_is_no_number_is_refused(value: Any) -> None:
    with pytest.raises(InvalidParamsError, match="is a number"):
        CommandParameters({"x": value}, "x").number("x", least=0.0, most=9.0)


def test_a_capture_is_read_whole() -> None:
    asked = capture_request({
        "label": "crack 7", "frequency_hz": 8, "excitation_amplitude_mm": 2.0, "phase_rad": 0.5, "group": "bolt A",
        "exposure_s": 1.0, "request_id": "r1",
    })  # fmt: skip
    assert (asked.label, asked.frequency_hz, asked.amplitude_mm, asked.group) == ("crack 7", 8.0, 2.0, "bolt A")
    assert (asked.phase_rad, asked.exposure_s, asked.request_id, asked.is_sharp) == (0.5, 1.0, "r1", False)
    nothing = capture_request({})
    assert (nothing.label, nothing.frequency_hz, nothing.is_sharp) == ("", None, False)


@pytest.mark.parametrize(("params", "words"), [
    ({"group": "a/b"}, "cannot name a result"),
    ({"group": "bolt", "sharp": True}, "a sharp one has none"),
    ({"frequency_hz": 0}, "frequency_hz is a number from 0.001"),
    ({"exposure_s": 7200}, "exposure_s is a number"),
    ({"label": "x" * 201}, "at most 200"),
    ({"amplitude_mm": 1.0}, "did you mean excitation_amplitude_mm"),
])  # fmt: skip
def test_a_capture_that_makes_no_sense_is_refused(params: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidParamsError, match=words):
        capture_request(params)
