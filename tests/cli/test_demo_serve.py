"""`labdaemon demo --serve`: the lines that it prints, pasted, show the first envelope within a minute."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labdaemon.cli.demo_serve import ServeAddresses, recipes

GOAL_S = 60.0
TOOLS = {"HTTP": "curl", "MQTT": "mosquitto_sub"}
RECIPES = recipes(ServeAddresses())


@pytest.mark.parametrize("title", RECIPES)
def test_lines_to_paste_are_ten_at_most(title: str) -> None:
    assert len(RECIPES[title].splitlines()) <= 10


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The demo on its fixed ports; what it printed before the first campaign."""
    pytest.importorskip("bluesky", reason="bluesky is not installed (extra peers)")
    out = tmp_path_factory.mktemp("serve") / "demo"
    command = [sys.executable, "-m", "labdaemon", "demo", "--serve", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    printed = ""
    for line in process.stdout:
        printed += line
        if "envelope of" in line or line.startswith("kill %1 %2"):
            break
    yield printed
    process.send_signal(signal.SIGINT)
    process.stdout.close()
    assert process.wait(60) == 130


@pytest.mark.peers
@pytest.mark.slow
@pytest.mark.parametrize("title", RECIPES)
def test_the_first_envelope_comes_within_a_minute(demo: str, title: str, tmp_path: Path, record_property) -> None:
    tool = TOOLS.get(title.split(maxsplit=1)[0])
    if tool is not None and shutil.which(tool) is None:
        pytest.skip(f"{tool} is not installed")
    lines = RECIPES[title]
    assert lines.split(" bridge ")[-1] in demo
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}:/usr/sbin"}
    began_s = time.monotonic()
    command = ["bash", "-c", lines]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=180)
    took_s = time.monotonic() - began_s
    print(f"{title}: {took_s:.1f} s")
    assert re.search(r"-steps-\d+\.000hz", done.stdout), done.stdout + done.stderr
    assert took_s <= GOAL_S
