"""Requests and answers as they travel: JSON-RPC 2.0, and how our errors become its codes."""

from __future__ import annotations

import contextlib
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon import errors
from labdaemon.stream import messages
from labdaemon.stream.messages import BadRequestError, RawJson, RpcRequest, parse_request

PLAIN = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)


def request(**members: object) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": 1, "method": "status"} | members).encode()


def test_a_request_is_read() -> None:
    assert parse_request(request(params={"campaign": "0001-a"})) == RpcRequest(
        "status", {"campaign": "0001-a"}, 1, is_notification=False
    )


def test_params_may_be_left_out_or_be_an_empty_list() -> None:
    assert parse_request(request()).params == {}
    assert parse_request(request(params=[])).params == {}


def test_without_an_id_it_is_a_notification_and_null_is_an_id() -> None:
    assert parse_request(b'{"jsonrpc":"2.0","method":"stop"}').is_notification
    assert not parse_request(request(id=None)).is_notification


def test_members_of_a_newer_client_are_ignored() -> None:
    assert parse_request(request(trace="abc", v=7)).method == "status"


@pytest.mark.parametrize(("frame", "code", "words"), [
    (b"\xff\xfe", messages.PARSE_ERROR, "not JSON"),
    (b"{", messages.PARSE_ERROR, "not JSON"),
    (b'{"x": NaN}', messages.PARSE_ERROR, "NaN"),
    (b"[]", messages.INVALID_REQUEST, "batches are not supported"),
    (b"7", messages.INVALID_REQUEST, "JSON object"),
    (request(id=True), messages.INVALID_REQUEST, "id is"),
    (request(id=[1]), messages.INVALID_REQUEST, "id is"),
    (request(id="x" * 201), messages.INVALID_REQUEST, "at most 200"),
    (request(id="\ud800"), messages.INVALID_REQUEST, "at most 200"),
    (request(jsonrpc="1.0"), messages.INVALID_REQUEST, "jsonrpc"),
    (request(method=3), messages.INVALID_REQUEST, "method is a string"),
    (request(params="x"), messages.INVALID_REQUEST, "params is an object"),
    (request(params=["x"]), messages.INVALID_PARAMS, "by name"),
    (request(params={"label": "\ud800"}), messages.INVALID_PARAMS, "label is no text"),
])  # fmt: skip
def test_what_is_no_request_is_refused_in_words(frame: bytes, code: int, words: str) -> None:
    with pytest.raises(BadRequestError, match=words) as caught:
        parse_request(frame)
    assert caught.value.code == code


def test_a_refusal_carries_the_id_as_far_as_it_could_be_read() -> None:
    for frame, expected in ((request(method=3, id="a"), "a"), (request(id=True), None), (b"{", None)):
        with pytest.raises(BadRequestError) as caught:
            parse_request(frame)
        assert caught.value.id == expected


@settings(max_examples=40, deadline=None, derandomize=True)
@given(method=PLAIN, params=st.dictionaries(PLAIN, PLAIN | st.integers(-1000, 1000)), id=st.integers() | PLAIN)
def test_what_a_client_sends_is_read_as_it_was_meant(method: str, params: dict[str, object], id: int | str) -> None:
    frame = messages.request_bytes(method, params, id)  # type: ignore[arg-type]
    assert parse_request(frame) == RpcRequest(method, params, id, is_notification=False)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.binary(max_size=200) | st.text(max_size=100).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_whatever_comes_is_a_request_or_refused(frame: bytes) -> None:
    with contextlib.suppress(BadRequestError):
        assert isinstance(parse_request(frame), RpcRequest)


def test_a_result_that_is_json_already_is_not_made_again() -> None:
    raw = messages.result_bytes(RawJson((b'{"events":', b"[1,2]}")), "a")
    assert json.loads(raw) == json.loads(messages.result_bytes({"events": [1, 2]}, "a"))


def test_an_error_names_its_code() -> None:
    answer = json.loads(messages.error_bytes(messages.LIMITS, "too fast", 3, key="phase[0]"))
    assert answer["error"] == {"code": -32002, "message": "too fast", "data": {"name": "limits", "key": "phase[0]"}}
    assert json.loads(messages.error_bytes(-1, "x", None))["error"]["data"]["name"] == "error"


def test_half_a_surrogate_pair_in_an_answer_is_spelled_out() -> None:
    """A file name that is no UTF-8 must reach the client as something that its parser takes."""
    answer = messages.error_bytes(messages.DEVICE, "/data/\udcff", 1)
    assert json.loads(answer)["error"]["message"] == "/data/\\udcff"


@pytest.mark.parametrize(("error", "code"), [
    (messages.BusyError("x"), messages.BUSY),
    (messages.ForbiddenError("x"), messages.FORBIDDEN),
    (messages.NotFoundError("x"), messages.NOT_FOUND),
    (messages.WrongStateError("x"), messages.WRONG_STATE),
    (messages.InvalidParamsError("x"), messages.INVALID_PARAMS),
    (messages.UnknownMethodError("x"), messages.METHOD_NOT_FOUND),
    (errors.LimitError("x"), messages.LIMITS),
    (errors.ConfigError("x"), messages.INVALID_PARAMS),
    (errors.UsageError("x"), messages.INVALID_PARAMS),
    (errors.InterlockError("x"), messages.WRONG_STATE),
    (errors.RestUnconfirmed("x"), messages.WRONG_STATE),
    (errors.TransportError("x"), messages.DEVICE),
    (errors.StorageFull("x"), messages.INTERNAL_ERROR),
    (errors.LabdaemonError("x"), messages.INTERNAL_ERROR),
])  # fmt: skip
def test_codes_say_who_is_at_fault(error: errors.LabdaemonError, code: int) -> None:
    assert messages.code_of(error) == code
    assert code in messages.NAMES


def test_only_what_is_busy_is_worth_another_try() -> None:
    kinds = [kind for kind in messages.CommandError.__subclasses__() if kind.retryable]
    assert kinds == [messages.BusyError]
