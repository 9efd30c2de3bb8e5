"""The sections of a rig file: addresses are addresses, commands are commands, numbers have ranges."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from labdaemon.rig_sections import GatewaySection, ServiceSection, WebSection


@pytest.mark.parametrize("address", [
    "tcp://127.0.0.1:5571", "tcp://127.1.2.3:1", "tcp://localhost:65535", "tcp://[::1]:80", "tcp://127.0.0.1:*",
])  # fmt: skip
def test_loopback_is_allowed(address: str) -> None:
    assert ServiceSection(events=address).events == address


@pytest.mark.parametrize(("address", "words"), [
    ("tcp://127.0.0.1:65536", "is no address"),
    ("tcp://127.0.0.1", "is no address"),
    ("udp://127.0.0.1:5571", "is no address"),
    ("", "is no address"),
])  # fmt: skip
def test_what_is_no_address_is_refused(address: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        ServiceSection(commands=address)


def test_two_sockets_need_two_addresses() -> None:
    with pytest.raises(ValidationError, match="share an address"):
        ServiceSection(events="tcp://127.0.0.1:5000", commands="tcp://127.0.0.1:5000")
    ServiceSection(events="tcp://127.0.0.1:*", commands="tcp://127.0.0.1:*")


@pytest.mark.parametrize(("command", "words"), [
    ("mail -s 'the rig' lab@example.org", ("mail", "-s", "the rig", "lab@example.org")),
    (["notify", "a b"], ("notify", "a b")),
    (None, None),
])  # fmt: skip
def test_a_command_is_a_program_and_its_arguments(command: Any, words: tuple[str, ...] | None) -> None:
    assert ServiceSection.model_validate({"on_fault": command}).on_fault_command == words


@pytest.mark.parametrize("command", ["'open", " ", [], ["a\0b"], ""])
def test_what_is_no_command_is_refused(command: Any) -> None:
    with pytest.raises(ValidationError):
        ServiceSection.model_validate({"on_fault": command})


@pytest.mark.parametrize("kind", [GatewaySection, WebSection])
def test_a_server_off_loopback_needs_a_token(kind: type[GatewaySection] | type[WebSection]) -> None:
    near, far = f"{kind.scheme}://127.0.0.1:8000", f"{kind.scheme}://0.0.0.0:8000"
    assert kind(address=near).is_loopback
    with pytest.raises(ValidationError, match="off loopback; name a token_file"):
        kind(address=far)
    assert not kind(address=far, token_file="token").is_loopback
    assert kind(address=f"{kind.scheme}://[::1]:*").host == "::1"
    assert kind(address=f"{kind.scheme}://LocalHost:1").is_loopback


@pytest.mark.parametrize("address", ["127.0.0.1:80", "ftp://127.0.0.1:80", "tcp://a b:80", "tcp://127.0.0.1:99999"])
def test_what_is_no_servers_address_is_refused(address: str) -> None:
    with pytest.raises(ValidationError, match="is no address"):
        GatewaySection(address=address)
