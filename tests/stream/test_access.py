"""The list of clients as a running daemon follows it."""

from __future__ import annotations

import os

import pytest

from labdaemon.errors import ConfigError
from labdaemon.stream.access import ABSENT_LOOKS, CLIENTS, KeyAccess
from labdaemon.stream.key_list import remove_client
from labdaemon.stream.roles import Role
from labdaemon.testing.stream_daemon import FakeKeys


@pytest.fixture
def changes(keys: FakeKeys) -> list[int]:
    seen: list[int] = []
    keys.access.listen(lambda: seen.append(len(keys.access.clients)))
    return seen


async def test_a_role_follows_the_list(keys: FakeKeys, changes: list[int]) -> None:
    assert keys.access.role_of(keys.operator.public) is Role.OPERATOR
    assert keys.access.role_of(keys.observer.public) is Role.OBSERVER
    remove_client(keys.folder / CLIENTS, "olga")
    await keys.access.look()
    assert keys.access.role_of(keys.operator.public) is None
    assert changes == [1]
    await keys.access.look()
    assert changes == [1]


async def test_a_change_counts_whatever_the_files_time_says(keys: FakeKeys, changes: list[int]) -> None:
    path = keys.folder / CLIENTS
    before = path.stat()
    text = path.read_text().replace("operator olga", "observer olga")  # as long as before
    path.write_text(text)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    await keys.access.look()
    assert keys.access.role_of(keys.operator.public) is Role.OBSERVER
    os.utime(path, (0, 0))  # the clock was set back
    path.write_text(text.replace("observer olga", "operator olga"))
    os.utime(path, (0, 0))
    await keys.access.look()
    assert keys.access.role_of(keys.operator.public) is Role.OPERATOR


async def test_a_slip_in_the_list_locks_no_one_out_and_is_logged_once(
    keys: FakeKeys, changes: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    path = keys.folder / CLIENTS
    path.write_text(path.read_text() + "operator half")
    for _ in range(3):
        await keys.access.look()
    assert keys.access.role_of(keys.operator.public) is Role.OPERATOR
    assert changes == []
    assert len([record for record in caplog.records if "line 4" in record.getMessage()]) == 1


async def test_a_list_that_is_gone_for_good_lets_no_one_in(keys: FakeKeys, changes: list[int]) -> None:
    text = (keys.folder / CLIENTS).read_text()
    (keys.folder / CLIENTS).unlink()
    for _ in range(ABSENT_LOOKS - 1):
        await keys.access.look()
    assert len(keys.access.clients) == 2  # an editor may be about to write it
    (keys.folder / CLIENTS).write_text(text)
    await keys.access.look()
    (keys.folder / CLIENTS).unlink()
    for _ in range(ABSENT_LOOKS):
        await keys.access.look()
    assert keys.access.clients == ()
    assert changes == [0]


def test_the_daemons_own_key_may_command(keys: FakeKeys) -> None:
    assert keys.access.role_of(keys.daemon.public) is Role.OPERATOR
    assert keys.access.name_of(keys.operator.public) == "olga"


def test_a_damaged_own_key_is_refused_and_not_replaced(keys: FakeKeys) -> None:
    path = keys.folder / "daemon.key"
    path.write_text("")
    with pytest.raises(ConfigError, match="is empty"):
        KeyAccess(keys.folder)
    assert path.read_text() == ""
