from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.bench.killed import QuickMeasurer
from labdaemon.campaign.measuring import Measured
from labdaemon.errors import DataError
from labdaemon.processing import ENVELOPE_COLUMNS, WorkerPool, read_csv
from labdaemon.service.measuring import PoolMeasurer


@pytest.fixture(scope="module")
def pool() -> Iterator[WorkerPool]:
    with WorkerPool(1, deadline_s=60.0) as pool:
        yield pool


def result(name: str, x_mm: float) -> Measured:
    row = dict.fromkeys(ENVELOPE_COLUMNS) | {"capture": name, "target": "T1", "x_mm": x_mm, "flags": ["at_rest"]}
    return Measured([row], [])


async def test_result_files_are_written_anew_and_added_to(tmp_path: Path, pool: WorkerPool):
    measurer = PoolMeasurer(pool)
    await measurer.write_results(tmp_path, (result(name, 1.5) for name in ("a", "b")))
    await measurer.append_results(tmp_path, result("c", 2.5))
    rows = read_csv(tmp_path / "results" / "envelope.csv")
    assert [(row["capture"], row["x_mm"], row["flags"]) for row in rows] == [
        ("a", 1.5, ["at_rest"]), ("b", 1.5, ["at_rest"]), ("c", 2.5, ["at_rest"]),
    ]  # fmt: skip
    await measurer.write_results(tmp_path, [])
    assert read_csv(tmp_path / "results" / "envelope.csv") == []
    assert {path.name for path in (tmp_path / "results").iterdir()} == {"envelope.csv", "measurements.csv"}


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
