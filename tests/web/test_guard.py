"""What every request has to pass: names, words, roles, and the number after which events are wanted."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdaemon.journal.event import EventText
from labdaemon.stream.access_token import AccessToken
from labdaemon.stream.roles import Role
from labdaemon.web.event_stream import LONGEST_SEQ, event_lines, first_seq
from labdaemon.web.guard import WebAccess, host_name, read_authorization


@pytest.mark.parametrize(("host", "name"), [
    ("localhost:5580", "localhost"), ("LOCALHOST", "localhost"), ("127.0.0.1:80", "127.0.0.1"), ("[::1]:5580", "::1"),
    ("[::1]", "::1"), ("rig.example.org.:80", "rig.example.org"), ("rig:x", "rig:x"), ("", ""), ("rig:", "rig"),
    ("rig:8０", "rig:8０"),
])  # fmt: skip
def test_a_host_is_its_name_without_port(host: str, name: str) -> None:
    assert host_name(host) == name


def basic(text: str) -> dict[str, str]:
    return {"authorization": "Basic " + base64.b64encode(text.encode()).decode()}


@pytest.mark.parametrize(("headers", "given"), [
    ({}, None),
    ({"authorization": ""}, None),
    ({"authorization": "Bearer abc"}, ("bearer", "abc")),
    ({"authorization": "bearer  abc "}, ("bearer", "abc")),
    (basic("anyone:secret:with:colons"), ("basic", "secret:with:colons")),
    (basic("nocolon"), ("basic", "")),
    ({"authorization": "Basic %%%"}, ("basic", "")),
    ({"authorization": "Basic /w=="}, ("basic", "")),
    ({"authorization": "Digest x"}, ("digest", "")),
])  # fmt: skip
def test_a_word_is_read_from_its_header(headers: dict[str, str], given: tuple[str, str] | None) -> None:
    assert read_authorization(headers) == given


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.text(max_size=60))
def test_whatever_the_header_says_is_read_without_an_error(text: str) -> None:
    found = read_authorization({"authorization": text})
    assert found is None or len(found) == 2


@pytest.fixture
def access(tmp_path: Path) -> WebAccess:
    def token(name: str) -> AccessToken:
        path = tmp_path / name
        path.write_text(name * 4)
        path.chmod(0o600)
        return AccessToken(path, "web")

    return WebAccess(frozenset({"localhost"}), token("operator"), token("observer"), is_open=False)


@pytest.mark.parametrize(("scheme", "word", "role"), [
    ("bearer", "operator" * 4, Role.OPERATOR),
    ("basic", "operator" * 4, Role.OBSERVER),
    ("bearer", "observer" * 4, Role.OBSERVER),
    ("basic", "observer" * 4, Role.OBSERVER),
    ("bearer", "operator", None),
    ("bearer", "", None),
])  # fmt: skip
def test_a_password_that_a_browser_remembers_reads_only(
    access: WebAccess, scheme: str, word: str, role: Role | None
) -> None:
    """A browser sends it along whatever page asks."""
    assert access.role_of(scheme, word) is role


def test_without_tokens_no_word_is_right() -> None:
    nothing = WebAccess(frozenset({"localhost"}), None, None, is_open=True)
    assert nothing.role_of("bearer", "operator" * 4) is None


@pytest.mark.parametrize(("query", "last", "seq"), [
    ({}, None, None), ({"after": "7"}, None, 7), ({"after": "7"}, "12", 12), ({"after": "0"}, "", 0),
    ({}, str(LONGEST_SEQ), LONGEST_SEQ),
])  # fmt: skip
def test_what_a_browser_has_seen_comes_before_what_its_address_says(
    query: dict[str, str], last: str | None, seq: int | None
) -> None:
    assert first_seq(query, last) == seq


@pytest.mark.parametrize("text", ["-1", "1.5", "x", " 7", "7 ", "٧", "9" * 20, str(LONGEST_SEQ + 1), "0x7"])
def test_what_is_no_number_of_events_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="whole number from 0"):
        first_seq({"after": text}, None)


def test_an_event_is_three_lines_and_an_empty_one() -> None:
    lines = event_lines(EventText(7, "capture.completed", b'{"seq":7}'))
    assert lines == b'id: 7\nevent: capture.completed\ndata: {"seq":7}\n\n'
