"""The OpenRPC document names every command with the parameters that its handler takes, and every event."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.events import KINDS, StatusReport, parse_event
from labdaemon.events.payloads import StatusData
from labdaemon.service import deferred_commands, openrpc
from labdaemon.service.handlers import handlers
from labdaemon.service.openrpc import REFERENCE, openrpc_document
from labdaemon.service.status import place_of, status_of
from labdaemon.stream.messages import InvalidParamsError
from labdaemon.testing.lab import FakeLab

UNLIKE = "zzzzzzzzzz"


def test_every_command_is_described():
    assert set(openrpc.METHODS) == set(deferred_commands.METHODS)


def test_every_reference_leads_somewhere():
    document = openrpc_document()
    text = json.dumps(document)
    schemas = document["components"]["schemas"]
    references = {part.partition('"')[0] for part in text.split(REFERENCE)[1:]}
    assert references
    assert references <= set(schemas)
    assert set(schemas["Event"]["discriminator"]["mapping"]) == set(KINDS)


async def at_once(work, *args):
    return work(*args)


def test_the_parameters_are_those_that_the_handlers_take(tmp_path: Path):
    clock = SimulatedClock()

    async def main() -> None:
        lab = FakeLab(tmp_path, clock)
        lab.start()
        served = handlers(lab.engine, lab.plan, dict, {}, aside=at_once)
        for name, method in openrpc.METHODS.items():
            if name == "stop":
                continue  # parameters of any name are let through
            with pytest.raises(InvalidParamsError, match="unknown parameter") as refused:
                await served[name]({UNLIKE: 1})
            known = str(refused.value).partition("known are ")[2]
            assert known == (", ".join(method.params) or "none"), name
        assert (await served["rpc.discover"]({}))["openrpc"] == "1.2.6"
        status = status_of(lab.engine, place_of(Path("rig.toml"), tmp_path))
        assert set(status) <= set(StatusData.model_fields)
        about = {"seq": 0, "at": "2026-05-04T10:11:12Z", "kind": "status"}
        assert isinstance(parse_event(about | {"data": status}), StatusReport)
        await lab.kill()

    clock.run(main())
