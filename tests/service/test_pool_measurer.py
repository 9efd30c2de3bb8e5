from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.bench.kill_child import QuickMeasurer
from labdaemon.errors import DataError
from labdaemon.processing import WorkerPool
from labdaemon.service.pool_measurer import PoolMeasurer


@pytest.fixture(scope="module")
def pool() -> Iterator[WorkerPool]:
    with WorkerPool(1, deadline_s=60.0) as pool:
        yield pool


async def test_a_folder_that_cannot_be_measured_says_so(tmp_path: Path, pool: WorkerPool):
    (tmp_path / "captures" / "one").mkdir(parents=True)
    with pytest.raises(Exception, match=r"rig\.toml|sharp") as caught:
        await PoolMeasurer(pool).measure(tmp_path, None, ["one"], "one")
    assert "Traceback" not in str(caught.value)


@pytest.mark.slow
async def test_a_poisoned_frame_kills_its_worker_and_the_next_capture_is_measured(tmp_path: Path):
    good = tmp_path / "captures" / "good"
    good.mkdir(parents=True)
    (good / "left.dng").write_bytes(b"frame")
    with WorkerPool(1, deadline_s=60.0) as pool:
        with pytest.raises(DataError, match="killed its worker process twice"):
            await asyncio.wrap_future(pool.submit(os._exit, 9))
        measured = await QuickMeasurer(pool).measure(tmp_path, None, ["good"], "good")
    assert [row["target"] for row in measured.envelope] == ["left"]
