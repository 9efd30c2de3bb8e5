"""The commands socket over real ZeroMQ: contract, idempotency, and peers that send rubbish."""

from __future__ import annotations

import asyncio
import json
import random
from collections.abc import AsyncIterator
from typing import Any

import pytest
import zmq
import zmq.asyncio

from labdaemon.errors import ConfigError, InterlockError, LimitError, TransportError, UsageError
from labdaemon.stream.commands import MAX_IN_PROGRESS, MAX_OF_ONE, CommandServer
from labdaemon.stream.messages import BusyError, ForbiddenError, NotFoundError, WrongStateError


class Lab:
    """Handlers that do something observable, and the server that offers them."""

    def __init__(self) -> None:
        self.shots = 0
        self.gate = asyncio.Event()
        self.server = CommandServer(
            "tcp://127.0.0.1:*",
            {
                "echo": self.echo,
                "capture": self.capture,
                "slow": self.slow,
                "stop": self.echo,
                "fail": self.fail,
                "rubbish": self.rubbish,
            },
        )
        self.errors: dict[str, BaseException] = {
            "busy": BusyError("one at a time"),
            "forbidden": ForbiddenError("observers may not"),
            "limits": LimitError("too far", source="campaign", key="phase[1].amplitude_mm"),
            "not_found": NotFoundError("no such campaign"),
            "wrong_state": WrongStateError("nothing is running"),
            "device": TransportError("the port is gone", device="shaker"),
            "invalid_params": UsageError("label is text"),
            "config": ConfigError("bad", source="campaign", key="name"),
            "interlock": InterlockError("response beyond 30 mm"),
            "internal_error": ZeroDivisionError("secret detail"),
            "cancelled": asyncio.CancelledError(),
            "exit": SystemExit(3),
            "interrupt": KeyboardInterrupt(),
            "generator": GeneratorExit(),
            "recursion": RecursionError("secret"),
            "memory": MemoryError(),
            "no_text": UsageError("the name \ud800 is no text"),
        }

    async def echo(self, params: dict[str, Any]) -> dict[str, Any]:
        return params

    async def capture(self, params: dict[str, Any]) -> dict[str, Any]:
        self.shots += 1
        shot = self.shots
        if params.get("fail"):
            raise TransportError("no answer", device="trigger")
        await self.gate.wait()
        return {"capture": f"c{shot}"}

    async def slow(self, params: dict[str, Any]) -> str:
        await self.gate.wait()
        return "done"

    async def fail(self, params: dict[str, Any]) -> None:
        raise self.errors[params["how"]]

    async def rubbish(self, params: dict[str, Any]) -> float:
        return float("nan")


@pytest.fixture
async def lab() -> AsyncIterator[Lab]:
    lab = Lab()
    lab.server.bind()
    task = asyncio.create_task(lab.server.run())
    yield lab
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    lab.server.close()


@pytest.fixture
async def dealer(lab: Lab) -> AsyncIterator[zmq.asyncio.Socket]:
    with zmq.asyncio.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.connect(lab.server.address)
        yield socket


async def receive(socket: zmq.asyncio.Socket) -> dict[str, Any]:
    async with asyncio.timeout(60):
        answer: dict[str, Any] = json.loads((await socket.recv_multipart())[-1])
    return answer


async def ask(socket: zmq.asyncio.Socket, method: str, message_id: Any = 1, **params: Any) -> dict[str, Any]:
    await socket.send_json({"jsonrpc": "2.0", "id": message_id, "method": method, "params": params})
    return await receive(socket)


async def test_a_dealer_gets_one_frame_back_with_its_id(dealer: zmq.asyncio.Socket) -> None:
    assert await ask(dealer, "echo", "abc", x=1.5) == {"jsonrpc": "2.0", "id": "abc", "result": {"x": 1.5}}


async def test_a_req_gets_its_delimiter_mirrored(lab: Lab) -> None:
    with zmq.asyncio.Context() as context, context.socket(zmq.REQ) as socket:
        socket.connect(lab.server.address)
        for number in range(3):
            answer = await ask(socket, "echo", number, n=number)
            assert answer["result"] == {"n": number}


async def test_a_req_that_tells_late_answers_by_a_number_is_answered(lab: Lab) -> None:
    with zmq.asyncio.Context() as context, context.socket(zmq.REQ) as socket:
        socket.set(zmq.REQ_CORRELATE, 1)
        socket.set(zmq.REQ_RELAXED, 1)
        socket.set(zmq.LINGER, 0)
        socket.connect(lab.server.address)
        for number in range(3):
            assert (await ask(socket, "echo", number, n=number))["result"] == {"n": number}


@pytest.mark.parametrize(
    ("frames", "mirrored"),
    [([b"proxy", b"client", b""], 3), ([b"", b""], 1), ([b"y" * 256, b""], 0), ([b"p%d" % n for n in range(9)], 0)],
    ids=["proxies", "two empty frames", "a long frame", "many frames"],
)
async def test_what_proxies_put_in_front_is_mirrored(
    dealer: zmq.asyncio.Socket, frames: list[bytes], mirrored: int
) -> None:
    await dealer.send_multipart([*frames, b'{"jsonrpc": "2.0", "id": 1, "method": "echo"}'])
    async with asyncio.timeout(60):
        *front, answer = await dealer.recv_multipart()
    assert front == frames[:mirrored]
    assert ("result" in json.loads(answer)) == (mirrored == len(frames))


async def test_unknown_members_are_ignored_and_params_optional(dealer: zmq.asyncio.Socket) -> None:
    await dealer.send_json({"jsonrpc": "2.0", "id": None, "method": "echo", "from": "the future", "params": []})
    assert await receive(dealer) == {"jsonrpc": "2.0", "id": None, "result": {}}


async def test_a_notification_is_done_and_not_answered(lab: Lab, dealer: zmq.asyncio.Socket) -> None:
    lab.gate.set()
    await dealer.send_json({"jsonrpc": "2.0", "method": "capture"})
    assert (await ask(dealer, "echo", 7))["id"] == 7
    assert lab.shots == 1


@pytest.mark.parametrize(
    ("how", "code", "name"),
    [
        ("busy", -32000, "busy"),
        ("forbidden", -32001, "forbidden"),
        ("limits", -32002, "limits"),
        ("not_found", -32003, "not_found"),
        ("wrong_state", -32004, "wrong_state"),
        ("interlock", -32004, "wrong_state"),
        ("device", -32005, "device"),
        ("invalid_params", -32602, "invalid_params"),
        ("config", -32602, "invalid_params"),
        ("internal_error", -32603, "internal_error"),
    ],
)
async def test_errors_become_codes(dealer: zmq.asyncio.Socket, how: str, code: int, name: str) -> None:
    error = (await ask(dealer, "fail", how=how))["error"]
    assert (error["code"], error["data"]["name"]) == (code, name)
    assert "secret" not in json.dumps(error)
    if how == "limits":
        assert error["data"]["key"] == "phase[1].amplitude_mm"
    if how == "device":
        assert error["data"]["device"] == "shaker"


@pytest.mark.parametrize("how", ["cancelled", "exit", "interrupt", "generator", "recursion", "memory", "no_text"])
async def test_no_kind_of_exception_keeps_a_place(dealer: zmq.asyncio.Socket, how: str) -> None:
    for number in range(MAX_OF_ONE + 1):
        error = (await ask(dealer, "fail", number, how=how))["error"]
        assert error["code"] == (-32602 if how == "no_text" else -32603)
        assert "secret" not in json.dumps(error)


@pytest.mark.parametrize(
    "params",
    [
        '{"label": "\\ud800"}',
        '{"request_id": "a\\udfffb"}',
        '{"list": [1, {"deep": "\\ud83d"}]}',
        '{"\\ud800": 1}',
    ],
)
async def test_half_a_surrogate_pair_is_no_parameter(dealer: zmq.asyncio.Socket, params: str) -> None:
    for method in ("echo", "capture", "stop"):
        await dealer.send(f'{{"jsonrpc":"2.0","id":7,"method":"{method}","params":{params}}}'.encode())
        answer = await receive(dealer)
        assert (answer["id"], answer["error"]["code"]) == (7, -32602)
    await dealer.send(b'{"jsonrpc":"2.0","id":7,"method":"echo","params":{"label":"\\ud83d\\ude00"}}')
    assert (await receive(dealer))["result"] == {"label": "\U0001f600"}


async def test_a_long_request_is_parsed_and_answered(dealer: zmq.asyncio.Socket) -> None:
    text = "x" * 500_000
    assert (await ask(dealer, "echo", text=text))["result"] == {"text": text}
    await dealer.send(b"[" * 500_000)
    assert (await receive(dealer))["error"]["code"] == -32700


async def test_a_result_that_is_no_json_is_an_internal_error(dealer: zmq.asyncio.Socket) -> None:
    assert (await ask(dealer, "rubbish"))["error"]["code"] == -32603


CORPUS: list[tuple[bytes, int]] = [
    (b"", -32700),
    (b"\x00\xff\xfe garbage", -32700),
    (b"\xff\xfe{\x00}\x00", -32700),
    (b"{", -32700),
    (b"[" * 500_000, -32700),
    (b'{"a":' * 100_000, -32700),
    (b"1" * 500_000, -32700),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":NaN}}', -32700),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":-Infinity}}', -32700),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":1e999}}', -32700),
    (b"[]", -32600),
    (b'[{"jsonrpc":"2.0","id":1,"method":"echo"}]', -32600),
    (b"null", -32600),
    (b'"echo"', -32600),
    (b"{}", -32600),
    (b'{"jsonrpc":"1.0","id":1,"method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":{"a":1},"method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":"\\ud800","method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":"' + b"x" * 1000 + b'","method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":' + b"9" * 300 + b',"method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":' + b"9" * 5000 + b"}}", -32700),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":0.' + b"9" * 5000 + b"}}", -32700),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":{"x":' + b"[" * 40 + b"]" * 40 + b"}}", -32700),
    (b'{"jsonrpc":"2.0","id":true,"method":"echo"}', -32600),
    (b'{"jsonrpc":"2.0","id":1,"method":5}', -32600),
    (b'{"jsonrpc":"2.0","id":1,"method":null,"params":{}}', -32600),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":"x"}', -32600),
    (b'{"jsonrpc":"2.0","id":1,"method":"echo","params":[1]}', -32602),
    (b'{"jsonrpc":"2.0","id":1,"method":"__class__"}', -32601),
    (b'{"jsonrpc":"2.0","id":1,"method":""}', -32601),
    (b'{"jsonrpc":"2.0","id":1,"method":"\\ud800"}', -32601),
    (b'{"jsonrpc":"2.0","id":1,"method":"capture","params":{"request_id":5}}', -32602),
    (b'{"jsonrpc":"2.0","id":1,"method":"capture","params":{"request_id":""}}', -32602),
]


@pytest.mark.parametrize(("frame", "code"), CORPUS, ids=range(len(CORPUS)))
async def test_hostile_frames_are_answered_with_the_reason(dealer: zmq.asyncio.Socket, frame: bytes, code: int) -> None:
    await dealer.send(frame)
    error = (await receive(dealer))["error"]
    assert error["code"] == code
    assert len(error["message"]) < 400
    assert (await ask(dealer, "echo", 2, alive=True))["result"] == {"alive": True}


@pytest.mark.parametrize("frames", [[b"a", b"b"], [b"", b"{}", b"c"], [b"", b""], [b"x"] * 5000])
async def test_many_frames_are_no_request(dealer: zmq.asyncio.Socket, frames: list[bytes]) -> None:
    await dealer.send_multipart(frames)
    assert (await receive(dealer))["error"]["code"] in {-32600, -32700}
    assert (await ask(dealer, "echo", 2))["id"] == 2


async def test_a_huge_frame_ends_its_connection_and_nobody_elses(lab: Lab, dealer: zmq.asyncio.Socket) -> None:
    with zmq.asyncio.Context() as context, context.socket(zmq.DEALER) as hostile:
        hostile.set(zmq.LINGER, 0)
        hostile.connect(lab.server.address)
        await hostile.send(b"x" * (8 << 20))
        assert (await ask(dealer, "echo", 1))["id"] == 1
        assert not await hostile.poll(200)


async def test_random_bytes_never_end_the_service(dealer: zmq.asyncio.Socket) -> None:
    randomness = random.Random(20160501)
    for _ in range(300):
        await dealer.send_multipart(
            [randomness.randbytes(randomness.randrange(40)) for _ in range(randomness.randrange(1, 4))]
        )
        assert "error" in await receive(dealer)


async def test_sent_again_it_answers_the_same_and_does_nothing_twice(lab: Lab, dealer: zmq.asyncio.Socket) -> None:
    for number in (1, 2):
        await dealer.send_json(
            {"jsonrpc": "2.0", "id": number, "method": "capture", "params": {"request_id": "night-1"}}
        )
    await ask_until(dealer)
    lab.gate.set()
    answers = [await receive(dealer), await receive(dealer), await ask(dealer, "capture", 3, request_id="night-1")]
    assert [answer["result"] for answer in answers] == [{"capture": "c1"}] * 3
    assert lab.shots == 1
    assert (await ask(dealer, "capture", 4, request_id="night-2"))["result"] == {"capture": "c2"}


async def ask_until(dealer: zmq.asyncio.Socket) -> None:
    """A round trip, after which everything sent before it has been started."""
    assert (await ask(dealer, "echo", "barrier"))["id"] == "barrier"


async def test_a_failure_may_be_tried_again_under_its_id(lab: Lab, dealer: zmq.asyncio.Socket) -> None:
    lab.gate.set()
    assert (await ask(dealer, "capture", request_id="r", fail=True))["error"]["code"] == -32005
    assert (await ask(dealer, "capture", request_id="r"))["result"] == {"capture": "c2"}


async def test_a_flood_is_refused_but_stop_gets_through(lab: Lab, dealer: zmq.asyncio.Socket) -> None:
    for number in range(MAX_OF_ONE + 10):
        await dealer.send_json({"jsonrpc": "2.0", "id": number, "method": "slow"})
    refused = [await receive(dealer) for _ in range(10)]
    assert {answer["error"]["code"] for answer in refused} == {-32000}
    assert "result" in await ask(dealer, "stop", "halt")
    lab.gate.set()
    assert {(await receive(dealer))["result"] for _ in range(MAX_OF_ONE)} == {"done"}
    assert (await ask(dealer, "slow", "again"))["result"] == "done"


async def test_one_clients_flood_leaves_room_for_others_until_all_is_full(lab: Lab) -> None:
    with zmq.asyncio.Context() as context:
        dealers = [context.socket(zmq.DEALER) for _ in range(MAX_IN_PROGRESS // MAX_OF_ONE + 1)]
        for place, dealer in enumerate(dealers):
            dealer.set(zmq.LINGER, 0)
            dealer.connect(lab.server.address)
            assert ("error" in await ask(dealer, "echo")) == (place == len(dealers) - 1)
            for number in range(MAX_OF_ONE):
                await dealer.send_json({"jsonrpc": "2.0", "id": number, "method": "slow"})
            if place < len(dealers) - 1:
                assert (await ask(dealer, "echo", "full"))["error"]["code"] == -32000
        assert "result" in await ask_past_refusals(dealers[-1], "stop")
        lab.gate.set()
        for dealer in dealers:
            dealer.close()


async def ask_past_refusals(dealer: zmq.asyncio.Socket, method: str) -> dict[str, Any]:
    """The answer to this question, after those to earlier ones."""
    await dealer.send_json({"jsonrpc": "2.0", "id": method, "method": method})
    while (answer := await receive(dealer))["id"] != method:
        assert answer["error"]["code"] == -32000
    return answer


async def test_a_second_daemon_on_the_address_is_told_so(lab: Lab) -> None:
    second = CommandServer(lab.server.address, {})
    with pytest.raises(ConfigError, match=r"service\.commands: .* is taken, most likely by a daemon"):
        second.bind()
    second.close()


async def test_an_address_of_another_machine_is_refused() -> None:
    server = CommandServer("tcp://192.0.2.1:5570", {})
    with pytest.raises(ConfigError, match="cannot be bound"):
        server.bind()
    server.close()
