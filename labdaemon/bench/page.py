"""`labdaemon bench page`: the report's time and size, and the live page in a browser: delay, heap, bytes, requests."""

from __future__ import annotations

import asyncio
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from labdaemon.bench.campaign_folder import write_campaign
from labdaemon.bench.shear_structure import Instrument, ShearStructure
from labdaemon.bench.world.row import WorldRow, table_of
from labdaemon.errors import UsageError
from labdaemon.report.folder_page import report_folder
from labdaemon.report.html import live_files
from labdaemon.testing.browser import Browser, browser_program
from labdaemon.testing.served import FakeDaemon

CAPTURES, PER_COLUMN = 100, 30
REPORT_S, REPORT_MB, PAGE_KB, DELAY_S = 60.0, 3.0, 200.0, 1.0
GROWTH = 0.05
"""Growth of the heap that counts as none, relative to its size after the first events."""
TARGETS = 60
SETTLED = 10
"""The first part of all events, after which what the page keeps is full: a tenth."""


def report_rows(seed: int = 1, captures: int = CAPTURES, per_column: int = PER_COLUMN) -> Iterator[WorldRow]:
    """Time and size of the report of a sweep with two columns of targets, a twentieth of them flagged."""
    structure, rng = ShearStructure(per_column=per_column), np.random.default_rng(seed)
    series = Instrument().measure(structure, np.geomspace(4.0, 26.0, captures), rng)
    names = tuple(f"{side}{k + 1:02d}" for side in "LR" for k in range(per_column))
    with tempfile.TemporaryDirectory(prefix="labdaemon-page-") as name:
        folder = write_campaign(Path(name), replace(series, targets=names), structure.positions_mm())
        _flag(folder / "results" / "envelope.csv", rng)
        began, cpu = time.perf_counter(), time.process_time()
        path, _ = report_folder(folder, title="bench")
        took, used, size = time.perf_counter() - began, time.process_time() - cpu, path.stat().st_size / 1e6
    what = f"report of {captures} captures of {2 * per_column} targets"
    yield WorldRow(
        "report", f"{what}: time", 1, f"{took:.1f} s ({used:.1f} s of CPU)", f"<= {REPORT_S:g} s", took <= REPORT_S
    )
    yield WorldRow("report", f"{what}: size", 1, f"{size:.2f} MB", f"<= {REPORT_MB:g} MB", size <= REPORT_MB)


def _flag(envelope: Path, rng: np.random.Generator) -> None:
    """Flag a twentieth of the rows: the table of flags is part of the page."""
    from labdaemon.processing import ENVELOPE_COLUMNS, read_csv, write_csv

    rows = list(read_csv(envelope))
    for row in rows:
        if rng.random() < 1 / 20:
            row["flags"] = ["poor_fit"]
    write_csv(envelope, ENVELOPE_COLUMNS, rows)


def live_rows(seed: int = 1, events: int = 10_000, envelopes: int = 20) -> Iterator[WorldRow]:
    """The live page in headless Chromium, fed by a web server whose daemon is in memory.

    Raises
    ------
    UsageError
        No Chromium is installed.
    """
    size = sum(len(text.encode()) for text in live_files().values()) / 1e3
    yield WorldRow("live page", "page, style and scripts", 1, f"{size:.0f} kB", f"<= {PAGE_KB:g} kB", size <= PAGE_KB)
    program = browser_program()
    if program is None:
        raise UsageError("no chromium is installed: the live page needs a browser to be measured in")
    seen = asyncio.run(_watch(program, np.random.default_rng(seed), events, envelopes))
    yield WorldRow("live page", "requests to other hosts", 1, str(seen["others"]), "0", seen["others"] == 0)
    worst = max(seen["delays"])
    yield WorldRow(
        "live page",
        f"envelope of {TARGETS} targets committed to drawn",
        envelopes,
        f"median {np.median(seen['delays']):.3f} s, largest {worst:.3f} s",
        f"<= {DELAY_S:g} s",
        worst <= DELAY_S,
    )
    first, last = seen["heap"]
    grown = (last - first) / first
    yield WorldRow(
        "live page",
        f"heap after {events // SETTLED} and after {events} events",
        events,
        f"{first / 1e6:.2f} and {last / 1e6:.2f} MB: {100 * grown:+.1f} %",
        f"<= {100 * GROWTH:+.0f} %",
        grown <= GROWTH,
    )
    yield WorldRow(
        "live page",
        "elements and listeners meanwhile",
        events,
        "{} and {} elements, {} and {} listeners".format(*seen["nodes"], *seen["listeners"]),
        "no more listeners",
        seen["listeners"][1] <= seen["listeners"][0],
    )


async def _watch(program: str, rng: np.random.Generator, events: int, envelopes: int) -> dict[str, Any]:
    from labdaemon.rig_sections import LOOPBACK_NAMES
    from labdaemon.web.guard import WebAccess
    from labdaemon.web.web_server import WebServer

    daemon = FakeDaemon()
    access = WebAccess(hosts=LOOPBACK_NAMES, operator=None, observer=None, is_open=True)
    server = WebServer("http://127.0.0.1:*", daemon.execute, daemon.outbox, access)
    server.bind()
    serving = asyncio.create_task(server.run())
    await asyncio.sleep(0.2)
    with tempfile.TemporaryDirectory(prefix="labdaemon-page-") as profile:
        browser = await asyncio.to_thread(Browser, program, server.address, Path(profile) / "browser", (1200, 900))
        try:
            await asyncio.to_thread(browser.wait_for, "document.title.includes('idle')")
            while "campaign.list" not in daemon.methods():  # its stream is asked for then
                await asyncio.sleep(0.02)
            return await _feed(daemon, server.wake, browser, rng, events, envelopes)
        finally:
            await asyncio.to_thread(browser.close)
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
            server.close()


async def _feed(
    daemon: FakeDaemon,
    wake: Callable[[], None],
    browser: Browser,
    rng: np.random.Generator,
    events: int,
    envelopes: int,
) -> dict[str, Any]:
    """Publish, and look at the browser's memory on the way."""
    heap, counters = [], []
    for until in (events // SETTLED, events):
        while daemon.outbox.last_seq < until:
            for _ in range(25):
                _publish_step(daemon, rng)
            wake()
            await _drawn(browser, daemon.outbox.last_seq)
        heap.append(await asyncio.to_thread(_heap_bytes, browser))
        counters.append(await asyncio.to_thread(browser.call, "Memory.getDOMCounters"))
    delays = []
    for _ in range(envelopes):
        began = time.perf_counter()
        _publish_step(daemon, rng)
        wake()
        await _drawn(browser, daemon.outbox.last_seq)
        delays.append(time.perf_counter() - began)
    others = 'performance.getEntriesByType("resource").filter((one) => !one.name.startsWith(location.origin)).length'
    return {
        "heap": heap,
        "delays": delays,
        "others": await asyncio.to_thread(browser.evaluate, others),
        "nodes": [one["nodes"] for one in counters],
        "listeners": [one["jsEventListeners"] for one in counters],
    }


def _publish_step(daemon: FakeDaemon, rng: np.random.Generator) -> None:
    """The events of a step; the envelope comes last."""
    number = daemon.outbox.last_seq
    gauge = {"gauge": "laser", "role": "table", "amplitude_mm": 2.0, "sd_amplitude_mm": 0.001, "phase_rad": 0.1}
    daemon.outbox.add("step.started", step=number, label="steps", frequency_hz=5.0)
    daemon.outbox.add("capture.completed", capture=f"c{number}", gauges=[gauge | {"reason": None}])
    daemon.outbox.add("step.completed", step=number, label="steps")
    rows = [_row(k, rng) for k in range(TARGETS)]
    daemon.outbox.add("envelope", capture=f"c{number}", frequency_hz=5.0, targets=rows)


def _row(place: int, rng: np.random.Generator) -> dict[str, Any]:
    vectors = rng.normal(size=9).round(6).tolist()
    names = [f"{kind}{axis}_mm" for kind in ("a", "b", "sd_a") for axis in "xyz"]
    where = {"x_mm": 150.0 * (place % 2), "y_mm": 0.0, "z_mm": 25.0 * place}
    return {"target": f"T{place:02d}", "flags": [], **where, **dict(zip(names, vectors, strict=True))}


async def _drawn(browser: Browser, seq: int) -> None:
    """Until the page has drawn this envelope."""
    shown = (
        f"new Promise((done) => {{ const look = () => Number(document.body.dataset.seq) >= {seq} ? done(true) : "
        "setTimeout(look, 5); look(); })"
    )
    await asyncio.to_thread(browser.evaluate, shown)


def _heap_bytes(browser: Browser) -> float:
    for _ in range(3):  # what the first collection frees may hold more
        browser.call("HeapProfiler.collectGarbage")
    return float(browser.call("Runtime.getHeapUsage")["usedSize"])


SECTIONS: dict[str, Callable[[int], Iterator[WorldRow]]] = {"report": report_rows, "live": live_rows}


@click.command("page")
@click.option("--section", "names", multiple=True, type=click.Choice(list(SECTIONS)), help="Only these.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(names: tuple[str, ...], seed: int, as_json: bool) -> None:
    """The report of 100 captures of 60 targets, and the live page over 10 000 events in headless Chromium."""
    rows: list[WorldRow] = []
    for name in names or SECTIONS:
        for row in SECTIONS[name](seed):
            rows.append(row)
            click.echo(f"{row.section}: {row.what}: {row.result} (goal {row.goal})", err=True)
    click.echo(json.dumps([row.as_json() for row in rows]) if as_json else table_of(rows))
    if not all(row.holds for row in rows):
        raise SystemExit(1)
