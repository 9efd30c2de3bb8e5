"""The rig file's devices: each driver found by its entry point, built, and given a thread of its own."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from typing import Any

from labdaemon.capture.context import CameraOverrides
from labdaemon.capture.device_executor import ThreadExecutor
from labdaemon.capture.rig import DeviceHandle, Rig
from labdaemon.errors import DeviceError
from labdaemon.service.config import RigConfig, find_driver

log: logging.Logger = logging.getLogger(__name__)

CONNECT_S = 20.0
"""A body that was asleep, or a port that a replug moved, takes its time."""


def build_rig(config: RigConfig) -> Rig:
    """Build every driver of a rig file. Opens nothing.

    Raises
    ------
    ConfigError
        No such driver, or it does not understand its section.
    """
    stop_actuators = build_stop_actuators(config)
    return Rig(
        stop_actuators.shaker,
        stop_actuators.trigger,
        {name: _build("camera", camera.driver, name, camera.settings) for name, camera in config.cameras.items()},
        tuple(_build("gauge", gauge.driver, gauge.name, gauge.settings) for gauge in config.gauges),
    )


def build_stop_actuators(config: RigConfig) -> Rig:
    """Build only what can stop the table, as a rig of nothing else; a wrong camera section does not matter here."""
    trigger = None
    if config.trigger.driver != "camera":
        trigger = _build("trigger", config.trigger.driver, "trigger", config.trigger.settings)
    shaker = None
    if config.shaker is not None:
        shaker = _build("shaker", config.shaker.driver, "shaker", config.shaker_settings())
    return Rig(shaker, trigger, {})


def camera_overrides(config: RigConfig) -> dict[str, CameraOverrides]:
    """What the rig file sets on each body."""
    return {name: CameraOverrides(camera.f_number, camera.iso) for name, camera in config.cameras.items()}


async def connect_stop_actuators(rig: Rig) -> dict[str, str]:
    """Reach whatever can stop the table, shaker and trigger, and return their identities; starts nothing.

    One that does not answer is left out: the part that keeps the table tries on to reach it.
    """
    found: dict[str, str] = {}
    for name, device in (("trigger", rig.trigger), ("shaker", rig.shaker)):
        if device is None:
            continue
        try:
            found[name] = await device.call(lambda driver: driver.connect(), CONNECT_S)
        except DeviceError as exc:
            log.error("%s", exc)
    return found


async def connect_others(rig: Rig) -> dict[str, str]:
    """Reach gauges and cameras at once, and return their identities."""
    gauges = [gauge.call(lambda driver: driver.connect(), CONNECT_S) for gauge in rig.gauges]
    cameras = [camera.call(lambda driver: driver.connect(), CONNECT_S) for camera in rig.cameras.values()]
    answers = await asyncio.gather(*gauges)
    seen = await asyncio.gather(*cameras)
    found = {gauge.driver.name: identity for gauge, identity in zip(rig.gauges, answers, strict=True)}
    for name, info in zip(rig.cameras, seen, strict=True):
        found[name] = f"{info.manufacturer} {info.model} {info.serial}"
    return found


def _build(kind: str, driver: str, name: str, settings: Mapping[str, Any]) -> DeviceHandle[Any]:
    return DeviceHandle(find_driver(kind, driver).load()(name, settings), ThreadExecutor(name))
