"""The public documents: kept in the repository, valid for public validators, and true of what is sent."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from click.testing import CliRunner
from openrpc import OpenRPC
from pydantic_asyncapi.v3 import AsyncAPI

from labdaemon.cli.main import cli
from labdaemon.clock import SimulatedClock
from labdaemon.events import KINDS
from labdaemon.service import openrpc
from labdaemon.service.api_documents import DOCUMENTS, asyncapi_document, document_text, jsonschema_document
from labdaemon.service.handlers import handlers
from labdaemon.service.status import place_of, status_of
from labdaemon.stream.messages import InvalidParamsError, RawJson
from labdaemon.testing.lab import FakeLab

KEPT = Path(__file__).parents[2] / "docs" / "reference" / "api"


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return jsonschema_document()


def part(schema: dict[str, Any], name: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator({"$schema": schema["$schema"], "$defs": schema["$defs"], "$ref": name})


@pytest.mark.parametrize("name", DOCUMENTS)
def test_what_is_kept_is_what_the_program_says(name: str) -> None:
    """Where this fails, the API has changed: say so in the changelog, and print the document anew."""
    kept = (KEPT / f"{name}.json").read_text(encoding="utf-8")
    assert json.loads(kept) == json.loads(document_text(name)), (
        f"labdaemon api --{name} > docs/reference/api/{name}.json"
    )
    assert CliRunner().invoke(cli, ["api", f"--{name}"]).output == document_text(name)


def test_public_validators_take_them(schema: dict[str, Any]) -> None:
    document = openrpc.openrpc_document()
    read = OpenRPC.model_validate(document)
    assert [method.name for method in read.methods] == list(openrpc.METHODS)
    events = AsyncAPI.model_validate(asyncapi_document())
    assert {channel.address for channel in (events.channels or {}).values()} == set(KINDS)
    jsonschema.Draft202012Validator.check_schema(schema)
    for one in document["components"]["schemas"].values():
        jsonschema.Draft7Validator.check_schema(one)  # what OpenRPC prescribes


def test_every_reference_of_every_document_leads_somewhere() -> None:
    for name in DOCUMENTS:
        document = json.loads(document_text(name))
        for reference in references(document):
            at = document
            for step in reference.removeprefix("#/").split("/"):
                at = at[step]


def references(node: Any) -> set[str]:
    if isinstance(node, list):
        return set().union(*map(references, node))
    if not isinstance(node, dict):
        return set()
    own = {node["$ref"]} if isinstance(node.get("$ref"), str) else set()
    return own.union(*map(references, node.values()))


def test_without_a_choice_it_says_what_there_is() -> None:
    done = CliRunner().invoke(cli, ["api"])
    assert (done.exit_code, "--openrpc" in done.output) == (2, True)


STEPS = '[[phase]]\nkind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nexposure_s = 1.0\n'


async def at_once(work: Any, *args: Any) -> Any:
    return work(*args)


WRONG: dict[str, list[Any]] = {
    "string": [1, True, [], {}, "x" * (1 << 21)],
    "boolean": ["false", "true", 0, 1, 1.0, []],
    "integer": ["1", True, 1.5, -1, [], 1 << 62],
    "number": ["1", True, [], {}, 1e300],
}


def test_answers_and_events_are_as_described_and_wrong_types_are_refused(
    tmp_path: Path, schema: dict[str, Any]
) -> None:
    clock = SimulatedClock()

    async def main() -> None:
        lab = FakeLab(tmp_path, clock)
        lab.start()
        place = place_of(Path("rig.toml"), tmp_path)
        rig = {
            "version": "1",
            "service": {"commands": "tcp://a", "events": "tcp://b", "data": "c"},
            "cameras": ["left"],
        }
        served = handlers(lab.engine, lab.plan, lambda: status_of(lab.engine, place), rig, aside=at_once)

        async def ask(method: str, **params: Any) -> Any:
            result = await served[method](params)
            plain = json.loads(result.text) if isinstance(result, RawJson) else json.loads(json.dumps(result))
            part(schema, f"#/$defs/{openrpc.METHODS[method].result.__name__}").validate(plain)
            openrpc.METHODS[method].result.model_validate(plain)
            return plain

        for name in ("first", "second"):
            await ask("campaign.submit", toml=f'name = "{name}"\n{STEPS}', request_id=name)
        listed = (await ask("campaign.list"))["campaigns"]
        assert [one["name"] for one in listed] == ["second", "first"]
        await ask("campaign.show", campaign=listed[0]["id"])
        for method in ("status", "rig", "events.latest", "rpc.discover", "stop"):
            await ask(method)
        for event in (await ask("events.replay"))["events"]:
            jsonschema.Draft202012Validator(schema).validate(event)
        for name, method in openrpc.METHODS.items():
            needed = dict.fromkeys(method.required, "x")
            for param, described in method.params.items() if name != "stop" else ():
                for value in WRONG[described["type"]]:
                    with pytest.raises(InvalidParamsError, match=rf"\b{param}\b"):
                        await served[name](needed | {param: value})
        with pytest.raises(InvalidParamsError, match="did you mean label"):
            await served["capture"]({"labell": "a"})
        await lab.kill()

    clock.run(main())
