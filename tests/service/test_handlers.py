from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.errors import LimitError
from labdaemon.service.deferred_commands import METHODS, DeferredCommands
from labdaemon.service.handlers import handlers
from labdaemon.service.status import status_of
from labdaemon.stream.messages import InvalidParamsError, WrongStateError
from labdaemon.testing.lab import FakeLab

CAMPAIGN = """
name = "handled"
[[phase]]
kind = "steps"
frequency_hz = [5.0]
amplitude_mm = 1.0
exposure_s = 1.0
"""


async def at_once(function, *args):
    """Another thread would be waited for in no simulated time at all."""
    return function(*args)


@pytest.fixture
def serve(tmp_path: Path):
    """Run a scenario of a lab and what is asked of it."""

    def run(scenario):
        clock = SimulatedClock()

        async def main():
            lab = FakeLab(tmp_path, clock)
            lab.start()
            deferred = DeferredCommands()
            served = handlers(lab.engine, lab.plan, lambda: status_of(lab.engine), {"rig": 1}, aside=at_once)
            deferred.serve(served, lab.journal)
            asked = deferred.handlers()
            try:
                await scenario(lab, deferred, lambda method, **params: asked[method](params))
            finally:
                await lab.kill()

        clock.run(main())

    return run


def test_every_method_of_the_contract_is_there():
    assert set(METHODS) == {
        "status", "rig", "campaign.submit", "campaign.pause", "campaign.resume", "campaign.abort", "capture",
        "campaign.list", "campaign.show", "campaign.move", "events.replay", "events.latest", "rpc.discover", "stop",
    }  # fmt: skip


def test_status_follows_a_campaign(serve):
    async def scenario(lab, deferred, ask):
        assert (await ask("status"))["state"] == "idle"
        answer = await ask("campaign.submit", toml=CAMPAIGN, request_id="r")
        assert Path(answer["folder"]).name == answer["campaign"]
        assert deferred.answer("r") == {"campaign": answer["campaign"]}
        await lab.clock.sleep(8.0)
        status = await ask("status")
        assert (status["state"], status["campaign"], status["name"]) == ("running", answer["campaign"], "handled")
        assert status["steps"] == 2
        assert status["captures_total"] == 4
        await lab.clock.sleep(3.0)
        assert (await ask("status"))["left_s"] < status["left_s"]  # within a step too
        assert (await ask("campaign.pause"))["campaign"] == answer["campaign"]
        await lab.clock.sleep(30.0)
        status = await ask("status")
        assert (status["state"], status["table"], status["reason"]) == ("paused", "rest", "asked for")
        taken = status["captures"]
        await ask("capture", label="by hand")
        await lab.clock.sleep(30.0)
        later = await ask("status")
        assert (later["captures"], later["captures_manual"]) == (taken, 1)  # counted apart
        assert later["left_s"] == status["left_s"]  # a pause takes no time from the plan
        assert (await ask("stop"))["rest"] == "soft"
        with pytest.raises(WrongStateError):
            await ask("campaign.pause")
        await ask("campaign.resume")
        await lab.until(answer["campaign"], "completed")
        replayed = json.loads((await ask("events.replay", after=0)).text)
        assert [event["seq"] for event in replayed["events"]] == list(range(1, lab.journal.last_seq + 1))
        assert replayed["journal"] == lab.journal.uuid
        newest = {event["kind"]: event for event in json.loads((await ask("events.latest")).text)["events"]}
        assert newest == {event["kind"]: event for event in replayed["events"]}

    serve(scenario)


def test_wrong_parameters_are_refused(serve):
    async def scenario(lab, deferred, ask):
        with pytest.raises(InvalidParamsError, match="toml is a text"):
            await ask("campaign.submit", toml=7)
        with pytest.raises(LimitError):
            await ask("campaign.submit", toml=CAMPAIGN.replace("1.0\nexp", "500.0\nexp"))
        with pytest.raises(InvalidParamsError, match="label is a text"):
            await ask("capture", label="x" * 300)
        with pytest.raises(InvalidParamsError, match="unknown parameter lable; did you mean label"):
            await ask("capture", lable="x")
        with pytest.raises(InvalidParamsError, match="sharp is true or false"):
            await ask("capture", sharp=1)
        with pytest.raises(InvalidParamsError, match="campaign is a text"):
            await ask("campaign.pause", campaign=["x"])
        assert (await ask("stop", lable="x"))["rest"] == "soft"  # whatever it says

    serve(scenario)


def test_a_command_before_there_is_somebody_to_do_it_waits():
    async def main() -> None:
        deferred = DeferredCommands()
        asked = asyncio.create_task(deferred.handlers()["status"]({}))
        await asyncio.sleep(0)
        assert not asked.done()
        assert deferred.answer("r") is None

        async def status(params):
            return "here"

        async def early(params):
            return "early"

        deferred.serve_early({"stop": early})
        assert await deferred.handlers()["stop"]({}) == "early"
        deferred.serve({"status": status}, None)  # type: ignore[arg-type]
        assert await asked == "here"

    asyncio.run(main())
