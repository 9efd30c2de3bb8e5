"""Stops the table without the daemon: what systemd runs after it, however it ended."""

from __future__ import annotations

import asyncio
from typing import Any

from labdaemon.capture.rig import Rig, Wired, bring_to_rest
from labdaemon.errors import DeviceError, InterlockError
from labdaemon.service.config import RigConfig
from labdaemon.service.devices import CONNECT_S, build_stoppers


def stop_table(config: RigConfig) -> str:
    """Bring the table to rest and say how.

    Raises
    ------
    InterlockError
        Neither shaker nor trigger confirmed.
    """
    return asyncio.run(_stop(build_stoppers(config)))


async def _stop(rig: Rig) -> str:
    if rig.shaker is None:
        return "the rig has no shaker"
    troubles: list[str] = []
    shaker = rig.shaker if await _reach(rig.shaker, troubles) else None
    trigger = rig.trigger if rig.trigger is not None and await _reach(rig.trigger, troubles) else None
    try:
        if shaker is None:
            if trigger is None:
                raise InterlockError(f"THE TABLE CANNOT BE REACHED ({'; '.join(troubles)}): use the emergency stop")
            await trigger.urgent(lambda driver: driver.drop_enable())
            return f"enable line dropped ({'; '.join(troubles)})"
        rest = await bring_to_rest(Rig(shaker, trigger, {}), at_once=True)
        return f"table at rest ({rest.by})"
    finally:
        await Rig(shaker, trigger, {}).close()


async def _reach(device: Wired[Any], troubles: list[str]) -> bool:
    try:
        await device.call(lambda driver: driver.connect(), CONNECT_S)
    except DeviceError as exc:
        troubles.append(str(exc))
        return False
    return True
