"""The live page: its files, and what a browser makes of them."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from typing import Any

import pytest

from labdaemon.testing.served import FakeDaemon
from labdaemon.web.web_server import WebServer

Start, Ask = Callable[..., WebServer], Callable[..., Any]
MOST_BYTES = 200_000
SHOWN = """(() => {
  const count = (path) => document.querySelectorAll(path).length;
  const text = (path) => document.querySelector(path).innerText;
  const other = performance.getEntriesByType("resource").filter((one) => !one.name.startsWith(location.origin)).length;
  return {
    options: count("#space option"), rows: count("#events tr"), bold: count("td b"), other: other,
    targets: text("#targets"), gauges: text("#gauges"), note: text(".note"),
    wide: document.documentElement.scrollWidth - innerWidth,
  };
})()"""


async def test_page_style_and_scripts_are_small_and_of_this_server_alone(serve: Start, ask: Ask) -> None:
    server = serve()
    page = await ask(server, "/")
    names = re.findall(r'(?:src|href)="(/live/[^"]+)"', page.body.decode())
    assert names == ["/live/page.css", "/live/live.css", "/live/space.js", "/live/live.js"]
    files = [page] + [await ask(server, name) for name in names]
    assert [one.status for one in files] == [200] * 5
    assert sum(len(one.body) for one in files) < MOST_BYTES
    for one in files:
        assert one.headers["content-security-policy"].startswith("default-src 'self';")
        assert not re.search(rb"https?://|@import|url\(|<script>|style=", one.body)


@pytest.mark.parametrize("name", ["live.html", "../app.py", "%2e%2e%2fapp.py", "other.js", ""])
async def test_other_files_are_not_there(serve: Start, ask: Ask, name: str) -> None:
    assert (await ask(serve(), f"/live/{name}")).status == 404


async def test_the_page_needs_the_same_word_as_the_numbers(serve: Start, ask: Ask) -> None:
    server = serve(is_open=False)
    assert [(await ask(server, path)).status for path in ("/", "/live/live.js", "/latest")] == [401] * 3


@pytest.fixture
def target() -> dict[str, Any]:
    axes = {"x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0, "ax_mm": 3.0, "ay_mm": 0.0, "az_mm": 0.0}
    return axes | {"bx_mm": 0.0, "by_mm": 4.0, "bz_mm": 0.0, "sd_ax_mm": 0.01, "flags": []}


@pytest.mark.slow
async def test_a_browser_shows_what_is_published_while_it_looks(
    serve: Start, daemon: FakeDaemon, open_browser: Start, target: dict[str, Any]
) -> None:
    rows = [target | {"target": "TOP", "z_mm": 500.0}, target | {"target": "<b>LOW</b>", "flags": ["occluded"]}]
    daemon.outbox.add("envelope", capture="first", frequency_hz=5.0, targets=rows)
    server = serve()
    browser = await asyncio.to_thread(open_browser, server.address)
    await asyncio.to_thread(browser.wait_for, "document.title.includes('labdaemon – idle')")
    await asyncio.to_thread(browser.wait_for, "document.querySelectorAll('#space option').length === 1")
    while "campaign.list" not in daemon.methods():  # it listens then
        await asyncio.sleep(0.02)
    gauge = {"gauge": "laser", "role": "table", "amplitude_mm": 2.0, "reason": None}
    for number in range(100):  # more than the page keeps
        daemon.outbox.add("envelope", capture=f"c{number}", frequency_hz=8.0, targets=rows)
    daemon.outbox.add("capture.completed", capture="last", gauges=[gauge])
    daemon.outbox.add("fault", device="camera left", message="does not answer")
    server.wake()
    await asyncio.to_thread(browser.wait_for, "document.querySelector('#events').innerText.includes('left')")
    shown = await asyncio.to_thread(
        browser.evaluate,
        SHOWN,
    )
    assert shown["options"] == 24  # what grows has an end
    assert shown["rows"] == 61
    assert "TOP\t4.0000" in shown["targets"]
    assert "<b>LOW</b>\t4.0000" in shown["targets"]  # a name is text, not markup
    assert shown["bold"] == 0
    assert "laser\ttable\t2.0000" in shown["gauges"]
    assert "phase between targets is not known" in shown["note"]
    assert shown["wide"] <= 0
    assert shown["other"] == 0


@pytest.mark.slow
async def test_a_silent_daemon_is_said(serve: Start, open_browser: Start, daemon: FakeDaemon) -> None:
    server = serve()
    browser = await asyncio.to_thread(open_browser, server.address, (400, 800))
    await asyncio.to_thread(browser.wait_for, "document.title.includes('idle')")
    daemon.errors["status"] = (-32000, "busy")
    await asyncio.to_thread(browser.wait_for, "document.querySelector('#alarm').innerText.includes('silent')")
    assert await asyncio.to_thread(browser.evaluate, "document.documentElement.scrollWidth <= innerWidth")
