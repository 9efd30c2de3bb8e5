"""The section ``[service]`` of a rig file: where the daemon listens, who may come in, and what it keeps."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from labdaemon.errors import ConfigError
from labdaemon.tomlfile import TomlSection, parse_model, read_toml

Written = Annotated[str, Field(pattern=r"^[^\x00]+$")]
"""A path or port: some text without a NUL."""

_LOOPBACK = re.compile(r"^tcp://(127(\.\d{1,3}){3}|localhost|\[::1\]):(\d{1,5}|\*)$")
_TCP = re.compile(r"^tcp://([A-Za-z0-9._-]+|\*|\[[0-9A-Fa-f:.]+(%[A-Za-z0-9._-]+)?\]):(\d{1,5}|\*)$")
_OPERATORS = re.compile(r"^(all|keys|owner|group:[A-Za-z_][A-Za-z0-9_.-]{0,31})$")
LONGEST_SOCKET_PATH = 90
"""Bytes of a Unix socket's path, with room for the name that it has until it is ready; the system takes 107."""


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches a TCP address."""
    return _LOOPBACK.match(address) is not None


class ServiceSection(TomlSection):
    """Where the daemon listens and what it writes to. Port ``*`` takes a free one, which the daemon prints."""

    events: str = "tcp://127.0.0.1:5571"
    commands: str = "tcp://127.0.0.1:5570"
    """``tcp://HOST:PORT`` or, for this machine alone, ``ipc:///PATH``. Off loopback every client needs a key."""
    keys: Written = "keys"
    """Folder of the daemon's own key and of the list of clients (``labdaemon keys``); relative to the rig file."""
    local_operators: str | None = None
    """Who of this machine may command: ``all`` who reach the address (loopback's default), those with ``keys``, and of
    Unix sockets the daemon's ``owner`` (their default) or members of ``group:NAME``. Holds for text gateway and HTTP as
    well: with any other policy than ``all`` they need tokens, HTTP for reading too. See `local_policy`."""
    data: Written = "data"
    """Folder of journal, campaigns and frames; relative to the rig file."""
    history_days: Annotated[float, Field(ge=0.01, le=36500, strict=True)] | None = None
    history_events: Annotated[int, Field(ge=1000, strict=True)] | None = None
    """How old events may become, and how many are kept, before they are cut from the journal; all by default."""
    on_fault: Written | tuple[Written, ...] | None = None
    """Command that carries faults and pauses to a person: program and arguments, in a list or as in a shell (no shell
    runs it). It reads a JSON object on stdin; a relative path starts at the rig file's folder."""
    reports: Annotated[bool, Field(strict=True)] = True
    """Whether the page ``results/index.html`` of a campaign is written when that has ended."""

    @property
    def on_fault_command(self) -> tuple[str, ...] | None:
        """Program and arguments of `on_fault`."""
        if self.on_fault is None or isinstance(self.on_fault, tuple):
            return self.on_fault
        return tuple(shlex.split(self.on_fault))

    def needs_keys(self, address: str) -> bool:
        """Whether each client of this address needs a key."""
        is_off_loopback = address.startswith("tcp://") and not is_loopback(address)
        return is_off_loopback or self.local_operators == "keys"

    @property
    def local_policy(self) -> str:
        """`local_operators`, or what the addresses imply: next to keys or a file no other way in is wider.

        A text gateway without a token next to a socket that only its owner can open would let everyone of the machine
        move the table.
        """
        if self.local_operators is not None:
            return self.local_operators
        addresses = (self.commands, self.events)
        if any(map(self.needs_keys, addresses)):
            return "keys"
        return "owner" if any(address.startswith("ipc://") for address in addresses) else "all"

    @property
    def restricts_operators(self) -> bool:
        """Whether not everyone of this machine may come in."""
        return self.local_policy != "all"

    @field_validator("on_fault")
    @classmethod
    def _a_command(cls, command: str | tuple[str, ...] | None) -> str | tuple[str, ...] | None:
        try:
            words = shlex.split(command) if isinstance(command, str) else command
        except ValueError as exc:
            raise ValueError(f"is no command: {exc}") from None
        if words is not None and not words:
            raise ValueError("is empty; name a program, or leave it out")
        return command

    @field_validator("local_operators")
    @classmethod
    def _a_policy(cls, policy: str | None) -> str | None:
        if policy is not None and not _OPERATORS.match(policy):
            raise ValueError(f"{policy[:40]!r} is no policy; write all, keys, owner or group:NAME")
        return policy

    @field_validator("events", "commands")
    @classmethod
    def _an_address(cls, address: str) -> str:
        if address.startswith("ipc://"):
            return _checked_path(address)
        port = address.rpartition(":")[2]
        if not _TCP.match(address) or not (port == "*" or int(port) < 1 << 16):
            raise ValueError(f"{address!r} is no address; write tcp://127.0.0.1:PORT or ipc:///PATH")
        return address

    @model_validator(mode="after")
    def _addresses_and_policy(self) -> ServiceSection:
        if self.events == self.commands and not self.events.endswith("*"):
            raise ValueError("events and commands share an address; give each its own")
        if self.local_operators not in {None, "all", "keys"}:
            for address in (self.events, self.commands):
                if is_loopback(address):
                    raise ValueError(
                        f"local_operators = {self.local_operators} is a matter of files, and {address} has none: write "
                        "ipc:///PATH, or local_operators = keys"
                    )
        return self


def read_service(path: Path) -> ServiceSection:
    """The section ``[service]`` of a rig file; nothing else of the file need be right but its syntax.

    Raises
    ------
    ConfigError
        The file cannot be read, or the section is wrong.
    """
    _, data = read_toml(path)
    section = data.get("service", {})
    if not isinstance(section, dict):
        raise ConfigError("is no table; write [service]", source=path, key="service")
    return parse_model(ServiceSection, section, source=path)


def keys_folder(path: Path, service: ServiceSection) -> Path:
    """Where the keys of a rig file lie."""
    return (path.parent / service.keys).resolve()


def _checked_path(address: str) -> str:
    path = address.removeprefix("ipc://")
    if not path.startswith("/"):
        raise ValueError(f"{address!r} has no absolute path; write ipc:///run/labdaemon/commands.sock")
    if len(path.encode()) > LONGEST_SOCKET_PATH:
        raise ValueError(f"the path of a socket has at most {LONGEST_SOCKET_PATH} bytes")
    return address
