"""From the command `capture` to the release on the trigger box's wire, through each way in."""

from __future__ import annotations

import http.client
import json
import re
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

from labdaemon.bench.stream.options import StreamOptions
from labdaemon.bench.stream.served_daemon import ServedDaemon, served_daemon
from labdaemon.bench.world.row import WorldRow
from labdaemon.errors import LabdaemonError
from labdaemon.stream.client import Client

GOAL_MS = 10.0
RELEASE = re.compile(rb"\bFIRE\b")
EXPOSURE_S = 0.05
STORED_S = 30.0


def rows(options: StreamOptions) -> Iterator[WorldRow]:
    """A row for each way in."""
    with served_daemon(options.seed) as served, ExitStack() as stack:
        probe = stack.enter_context(Client(served.commands, timeout_s=60.0))
        ways: dict[str, Callable[[], None]] = {
            "JSON-RPC": _by_rpc(served, stack),
            "HTTP": _by_http(served, stack),
            "text gateway": _by_text(served, stack),
        }
        for name, fire in ways.items():
            _latency_s(served, fire, probe)  # what is made for the first capture only
            found_ms = sorted(1e3 * _latency_s(served, fire, probe) for _ in range(options.captures))
            p95_ms = found_ms[min(int(0.95 * len(found_ms)), len(found_ms) - 1)]
            result = f"median {statistics.median(found_ms):.1f} ms, p95 {p95_ms:.1f} ms, without the disk's sync"
            what = f"capture by {name} to the release on the wire"
            yield WorldRow("latency", what, options.captures, result, f"p95 <= {GOAL_MS:g} ms", p95_ms <= GOAL_MS)


def _latency_s(served: ServedDaemon, fire: Callable[[], None], probe: Client) -> float:
    """Of one capture, asked for when the one before it is stored."""
    before, last = len(served.trigger.passed), _last_stored(probe)
    began_s = time.monotonic()
    fire()
    end_s = time.monotonic() + STORED_S
    while _last_stored(probe) == last:
        if time.monotonic() > end_s:
            raise LabdaemonError("the capture was not stored")
        time.sleep(0.02)
    for at_s, data in served.trigger.passed[before:]:
        if RELEASE.search(data):
            return at_s - began_s
    raise LabdaemonError("no release passed the wire")


def _last_stored(probe: Client) -> int:
    event = probe.latest().get("capture.completed")
    return 0 if event is None else int(event["seq"])


def _by_rpc(served: ServedDaemon, stack: ExitStack) -> Callable[[], None]:
    client = stack.enter_context(Client(served.commands, timeout_s=60.0))

    def fire() -> None:
        client.call("capture", label="rpc", exposure_s=EXPOSURE_S)

    return fire


def _by_http(served: ServedDaemon, stack: ExitStack) -> Callable[[], None]:
    connection = http.client.HTTPConnection(served.web.removeprefix("http://"), timeout=60.0)
    stack.callback(connection.close)
    headers = {"Authorization": f"Bearer {served.token}", "Content-Type": "application/json"}
    body = json.dumps({"label": "http", "exposure_s": EXPOSURE_S})

    def fire() -> None:
        connection.request("POST", "/command/capture", body, headers)
        answer = connection.getresponse()
        text = answer.read()
        if answer.status != 200:
            raise LabdaemonError(f"{answer.status}: {text[:200]!r}")

    return fire


def _by_text(served: ServedDaemon, stack: ExitStack) -> Callable[[], None]:
    sock = stack.enter_context(served.connect(served.gateway))
    sock.settimeout(60.0)
    answers = stack.enter_context(sock.makefile("r"))
    sock.sendall(b"CAPT:EXP 50 MS;LAB text\n")

    def fire() -> None:
        sock.sendall(b"TRIG;*OPC?\n")
        if answers.readline().strip() != "1":
            raise LabdaemonError("the text gateway did not answer")

    return fire
