"""History is cut while captures are recorded, and replay says so; moved campaigns run in their new order."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from labdaemon.clock import SimulatedClock
from labdaemon.journal.retention import Retention
from labdaemon.service.handlers import handlers
from labdaemon.service.history import CHECK_S, keep_history
from labdaemon.stream.messages import NotFoundError, RawJson, WrongStateError
from labdaemon.testing.lab import FakeLab

CAMPAIGN = '[[phase]]\nkind = "steps"\nfrequency_hz = 5.0\namplitude_mm = 1.0\nexposure_s = 1.0\n'


async def at_once(work: Any, *args: Any) -> Any:
    return work(*args)


def test_history_is_cut_and_replay_says_where_it_begins(tmp_path: Path) -> None:
    clock = SimulatedClock()

    async def main() -> None:
        lab = FakeLab(tmp_path, clock)
        lab.start()
        recorder = lab.engine.context.recorder
        with recorder.journal.transaction("test") as write:
            for _ in range(4000):
                write.emit("fault", None, {"message": "m"})
        keeping = asyncio.create_task(keep_history(recorder, Retention(events=1500), clock))
        await clock.sleep(CHECK_S / 2)
        served = handlers(lab.engine, lab.plan, dict, {}, aside=at_once)
        answer = await served["events.replay"]({"after": 10, "limit": 1})
        assert isinstance(answer, RawJson)
        replayed = json.loads(answer.text)
        assert (replayed["gone_before"], replayed["events"][0]["seq"]) == (2501, 2501)
        keeping.cancel()
        await lab.kill()

    clock.run(main())


def test_a_moved_campaign_runs_in_its_new_place(tmp_path: Path) -> None:
    clock = SimulatedClock()

    async def main() -> None:
        lab = FakeLab(tmp_path, clock)
        lab.start()
        served = handlers(lab.engine, lab.plan, dict, {}, aside=at_once)
        ids = []
        for name in "abc":
            ids.append((await served["campaign.submit"]({"toml": f'name = "{name}"\n{CAMPAIGN}'}))["campaign"])
            await clock.sleep(0.5)
        assert lab.engine.current is not None
        assert lab.engine.current.id == ids[0]
        assert (await served["campaign.move"]({"campaign": ids[2]}))["queue"] == [ids[2], ids[1]]
        with pytest.raises(WrongStateError, match="does not wait"):
            await served["campaign.move"]({"campaign": ids[0]})
        with pytest.raises(NotFoundError, match="no campaign 'none'"):
            await served["campaign.move"]({"campaign": "none"})
        listed = (await served["campaign.list"]({"limit": 1}))["campaigns"]
        assert [(one["id"], one["place"]) for one in listed] == [(ids[2], 0), (ids[1], 1), (ids[0], None)]
        await served["campaign.abort"]({})
        while lab.engine.current is None or lab.engine.current.id == ids[0]:
            await clock.sleep(0.5)
        assert lab.engine.current.id == ids[2]
        shown = await served["campaign.show"]({})
        assert (shown["id"], shown["results"]) == (ids[2], f"{shown['folder']}/results")
        await lab.kill()

    clock.run(main())
