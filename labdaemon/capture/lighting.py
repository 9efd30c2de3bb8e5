"""Light of a capture: constant, or a code that the trigger device plays while the shutters are open."""

from __future__ import annotations

from typing import cast

from labdaemon.capture.context import AcquisitionContext
from labdaemon.capture.devices import Firing, Trigger
from labdaemon.capture.lamp import LightCodePlayer, LightRequest, PlayedLight, plays_light
from labdaemon.capture.request import CaptureRequest
from labdaemon.capture.rig import CALL_S, DeviceHandle
from labdaemon.errors import DeviceError, DeviceRefused
from labdaemon.journal import transitions

FULL_LIGHT = 1.0
PLAY_S = 2.0
"""A code has ended by the time that the frames have come; so much later it has failed."""


async def release(context: AcquisitionContext, trigger: DeviceHandle[Trigger], request: CaptureRequest) -> Firing:
    """Release the shutters under the light that the capture asks for; returns when they have opened.

    Raises
    ------
    DeviceError
        The trigger device failed or refused.
    """
    timeout_s = request.exposure_s + CALL_S
    if request.light is not None:
        light, frequency_hz = request.light, request.frequency_hz or 0.0
        if context.lamp is None:
            raise DeviceRefused("is to play a light code, but the rig file has no [lamp]", device=trigger.driver.name)
        if not plays_light(trigger.driver):
            raise DeviceRefused("has no lamp output to play a light code", device=trigger.driver.name)
        return await trigger.call(
            lambda driver: _player(driver).fire_coded(request.exposure_s, light, frequency_hz=frequency_hz), timeout_s
        )
    if context.lamp is not None and plays_light(trigger.driver):
        # Each time: a box that was switched off and on may have come back with another light.
        await trigger.call(lambda driver: _player(driver).set_lamp(FULL_LIGHT))
    return await trigger.call(
        lambda driver: driver.fire(
            request.exposure_s, frequency_hz=request.frequency_hz, phase_rad=request.trigger_phase_rad
        ),
        timeout_s,
    )


async def record_light(context: AcquisitionContext, request: CaptureRequest) -> None:
    """Note the code that was played, once the shutters have closed. Does nothing under constant light.

    Raises
    ------
    DeviceError
        Something else was played than was asked for: the frames are set aside and the shot is repeated.
    """
    if request.light is None or context.lamp is None or context.rig.trigger is None:
        return
    trigger, asked = context.rig.trigger, request.light
    played = await trigger.call(lambda driver: _player(driver).read_played(PLAY_S), PLAY_S + CALL_S)
    if played.cycles != asked.cycles or len(played.brightness) != len(asked.brightness):
        raise DeviceError(_difference(asked, played), device=trigger.driver.name)
    record = context.lamp.record(played)
    await context.recorder.write(transitions.light_capture, request.campaign, request.name, record)


def _difference(asked: LightRequest, played: PlayedLight) -> str:
    return (
        f"played {played.cycles} cycles of {len(played.brightness)} sectors where {asked.cycles} of "
        f"{len(asked.brightness)} were asked for"
    )


def _player(driver: Trigger) -> LightCodePlayer:
    """A trigger that was found to play codes."""
    return cast(LightCodePlayer, driver)
