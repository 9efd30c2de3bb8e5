"""The list of clients: comments, slips of a person, and keys that contain what begins a comment."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon.errors import ConfigError, UsageError
from labdaemon.stream.key_list import ListedClient, add_client, parse_clients, read_clients, remove_client
from labdaemon.stream.roles import Role

A, B = "2Wrjd:WS.v9cE%f26vo7dLxYiz1%L8LQAKYE}mCa", "1iLm4M4NNgcms8deUp5RAMkJ.sXyo:v?^mSy@.i8"
"""Fixed: test names contain them, and every worker must collect the same names."""
HASH = "0000#" * 8


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "clients.txt"


def test_comments_empty_lines_and_any_white_space_are_fine() -> None:
    text = f"\ufeff# who may come in\n\n  operator\tolga   {A}   # the lab's PC\r\nobserver otto {B}#x\n".replace(
        "#x", ""
    )
    assert parse_clients(text) == (
        ListedClient("olga", Role.OPERATOR, A),
        ListedClient("otto", Role.OBSERVER, B),
    )


def test_a_key_may_contain_what_begins_a_comment() -> None:
    assert parse_clients(f"observer otto {HASH} # his\n")[0].public == HASH


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("operator olga", "a line is"),
        (f"operator olga {B} more", "a line is"),
        (f"admin olga {B}", "'admin' is no role"),
        (f"Operator olga {B}", "'Operator' is no role"),
        (f"operator ol/ga {B}", "is no name"),
        (f"operator {B} olga", "is no name"),
        (f"operator olga {B[:-1]}", "cut off"),
        (f"operator other {A}", "this key is on line 1 already"),
        (f"observer first {B}", "this name is on line 1 already"),
        ("operator", "a line is"),
    ],
)
def test_a_slip_is_named_by_its_line(line: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why) as refused:
        parse_clients(f"observer first {A}\n{line}\n", "clients.txt")
    assert str(refused.value).startswith("clients.txt: line 2: ")


def test_no_file_is_no_client(path: Path) -> None:
    assert read_clients(path) == ()


def test_a_list_that_anyone_can_add_to_is_refused(path: Path) -> None:
    add_client(path, ListedClient("olga", Role.OPERATOR, A))
    path.chmod(0o666)
    with pytest.raises(ConfigError, match="chmod o-w"):
        read_clients(path)


def test_clients_come_and_go_and_comments_stay(path: Path) -> None:
    add_client(path, ListedClient("olga", Role.OPERATOR, A))
    path.write_text(path.read_text() + "# olga left in May\n   # operator olga was hers")
    add_client(path, ListedClient("otto", Role.OBSERVER, B))
    assert remove_client(path, "olga").public == A
    assert [client.name for client in read_clients(path)] == ["otto"]
    assert path.read_text().count("#") == 3


def test_a_name_is_given_once(path: Path) -> None:
    add_client(path, ListedClient("olga", Role.OPERATOR, A))
    with pytest.raises(UsageError, match="olga has a key already"):
        add_client(path, ListedClient("olga", Role.OBSERVER, B))
    for name in ("", "a b", "a/b", "x" * 65, "é", "-a"):
        with pytest.raises(UsageError, match="is no name"):
            add_client(path, ListedClient(name, Role.OBSERVER, B))


def test_who_is_not_there_cannot_be_revoked(path: Path) -> None:
    add_client(path, ListedClient("olga", Role.OPERATOR, A))
    with pytest.raises(UsageError, match="listed are olga"):
        remove_client(path, "otto")
