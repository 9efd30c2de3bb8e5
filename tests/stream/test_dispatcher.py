"""Requests carried out without any socket: roles, request ids and errors."""

from __future__ import annotations

import json
from typing import Any

import pytest

from labdaemon.errors import LimitError
from labdaemon.service import openrpc
from labdaemon.stream.dispatcher import CommandDispatcher
from labdaemon.stream.messages import ForbiddenError, RpcRequest, UnknownMethodError
from labdaemon.stream.roles import OBSERVER_COMMANDS, Role, check_role


class Shots:
    def __init__(self) -> None:
        self.count = 0

    async def capture(self, params: dict[str, Any]) -> int:
        self.count += 1
        if params.get("amplitude") == "far":
            raise LimitError("too far", key="amplitude")
        return self.count

    async def status(self, params: dict[str, Any]) -> dict[str, Any]:
        return {"state": "idle"}


@pytest.fixture
def shots() -> Shots:
    return Shots()


@pytest.fixture
def dispatcher(shots: Shots) -> CommandDispatcher:
    return CommandDispatcher({"capture": shots.capture, "stop": shots.capture, "status": shots.status})


def request(method: str, **params: Any) -> RpcRequest:
    return RpcRequest(method, params, 7, False)


async def test_an_operator_may_do_everything(dispatcher: CommandDispatcher) -> None:
    assert await dispatcher.handle(request("status"), Role.OPERATOR) == {"state": "idle"}
    assert await dispatcher.handle(request("capture"), Role.OPERATOR) == 1


async def test_an_observer_may_read_and_nothing_else(dispatcher: CommandDispatcher, shots: Shots) -> None:
    assert await dispatcher.handle(request("status"), Role.OBSERVER) == {"state": "idle"}
    for method in ("capture", "stop"):
        with pytest.raises(ForbiddenError, match=f"{method} is for operators"):
            await dispatcher.handle(request(method), Role.OBSERVER)
    assert shots.count == 0


async def test_a_client_without_a_role_may_nothing(dispatcher: CommandDispatcher, shots: Shots) -> None:
    with pytest.raises(ForbiddenError, match="not listed"):
        await dispatcher.handle(request("status"), None)


async def test_a_method_that_is_not_there_is_no_matter_of_permission(dispatcher: CommandDispatcher) -> None:
    with pytest.raises(UnknownMethodError, match="'statu'"):
        await dispatcher.handle(request("statu"), Role.OBSERVER)


async def test_a_refused_request_is_not_kept_under_its_id(dispatcher: CommandDispatcher, shots: Shots) -> None:
    with pytest.raises(ForbiddenError):
        await dispatcher.handle(request("capture", request_id="a"), Role.OBSERVER)
    assert await dispatcher.handle(request("capture", request_id="a"), Role.OPERATOR) == 1
    assert await dispatcher.handle(request("capture", request_id="a"), Role.OPERATOR) == 1
    assert shots.count == 1


async def test_an_answer_carries_the_word_and_the_key(dispatcher: CommandDispatcher) -> None:
    answer = json.loads(await dispatcher.answer(request("capture", amplitude="far"), Role.OPERATOR))
    assert answer["id"] == 7
    assert answer["error"]["data"] == {"name": "limits", "key": "amplitude"}
    answer = json.loads(await dispatcher.answer(request("capture"), Role.OBSERVER))
    assert (answer["error"]["code"], answer["error"]["data"]["name"]) == (-32001, "forbidden")


def test_what_moves_the_table_or_writes_is_never_an_observers() -> None:
    for method in set(openrpc.METHODS) - OBSERVER_COMMANDS:
        with pytest.raises(ForbiddenError):
            check_role(method, Role.OBSERVER)
    assert OBSERVER_COMMANDS.isdisjoint({"stop", "capture"})
    assert not any(method.endswith((".submit", ".abort", ".pause", ".resume", ".move")) for method in OBSERVER_COMMANDS)
