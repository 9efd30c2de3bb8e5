"""A small daemon for tests of the guardian: it moves a SCPI shaker, beats, and hangs on request.

``python ward_program.py PORT CONFIG REPORT``; it prints a line of JSON for each thing that happens, and reads from
standard input ``hang``, ``fork``, ``describe``,
``give up`` or ``end``.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from labdaemon.clock import SystemClock
from labdaemon.service.guardian_process import GuardianSettings
from labdaemon.service.guardian_supervisor import GuardianSupervisor
from labdrivers.scpi import ScpiShaker


def say(**what: Any) -> None:
    print(json.dumps(what), flush=True)


async def main(port: str, config: str, report: str) -> None:
    shaker = ScpiShaker("shaker", json.loads(Path(config).read_text()) | {"port": port})
    shaker.connect()
    moving = True
    recipe = shaker.stop_recipe()
    assert recipe is not None
    guardian = GuardianSupervisor(recipe, GuardianSettings(config, Path(report)), SystemClock(), lambda: moving)
    guardian.on_lost = lambda reason: say(lost=reason)
    await guardian.start()
    beating = asyncio.create_task(guardian.run())
    guardian.arm()
    await asyncio.to_thread(shaker.set, 5.0, 1.0)
    say(**guardian.describe())
    while True:
        line = (await asyncio.to_thread(sys.stdin.readline)).strip()
        if line == "hang":
            time.sleep(3600.0)
        if line == "fork":
            child = os.fork()
            if child == 0:
                time.sleep(30.0)  # holds all descriptors of its parent, the pipe to the guardian as well
                os._exit(0)
            say(child=child)
        if line == "describe":
            say(**guardian.describe())
        if line == "give up":  # an end that leaves the table moving, as after a stop that nothing confirmed
            sys.exit(1)
        if line == "end":
            shaker.stop_now()
            moving = False
            break
    beating.cancel()
    await guardian.release()


asyncio.run(main(*sys.argv[1:]))
