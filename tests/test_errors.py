"""The tree of errors: who is at fault, whether a retry can help, and how a message begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from labdaemon import errors
from labdaemon.errors import ConfigError, DataError, DeviceError, LabdaemonError, RestUnconfirmed


def tree(root: type[LabdaemonError]) -> list[type[LabdaemonError]]:
    return [root, *(kind for child in root.__subclasses__() for kind in tree(child))]


OURS = [kind for kind in tree(LabdaemonError) if kind.__module__ == errors.__name__]


@pytest.mark.parametrize(("error", "message"), [
    (ConfigError("too fast", source="lab.toml", key="phase[2].hold_s"), "lab.toml: phase[2].hold_s: too fast"),
    (ConfigError("too fast", key="trigger"), "trigger: too fast"),
    (ConfigError("too fast"), "too fast"),
    (DataError("has no pixels", file=Path("a.nef")), "a.nef: has no pixels"),
    (DeviceError("no answer", device="left"), "left: no answer"),
    (DeviceError("no answer"), "no answer"),
])  # fmt: skip
def test_a_message_begins_with_the_place(error: LabdaemonError, message: str) -> None:
    assert str(error) == message


@pytest.mark.parametrize("kind", OURS)
def test_each_states_its_exit_status_and_documents_itself(kind: type[LabdaemonError]) -> None:
    assert kind.exit_status in {1, 2}
    assert kind.__doc__


def test_an_interlock_is_never_retried_by_itself() -> None:
    assert not any(kind.retryable for kind in tree(errors.InterlockError))


def test_what_may_pass_is_worth_another_try() -> None:
    names = {kind.__name__ for kind in OURS if kind.retryable}
    assert names == {"StorageUnavailable", "StorageFull", "TransportError", "ProtocolError", "DriverFault"}


def test_a_running_service_never_ends_with_the_status_of_a_wrong_file() -> None:
    """systemd does not restart after status 2."""
    assert errors.ServiceFailure.exit_status == 1
    assert errors.StorageUnavailable.exit_status == 1


def test_an_unconfirmed_stop_says_what_is_seen_of_the_table() -> None:
    assert RestUnconfirmed("x").table == "unconfirmed"
    assert RestUnconfirmed("x", table="moving").table == "moving"
