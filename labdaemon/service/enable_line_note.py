"""What a rig file says of the enable line, before anything was asked of the rig: for `labdaemon plan`."""

from __future__ import annotations

from typing import Any

from labdaemon.capture.abilities import holds_enable_line, reports_amplifier
from labdaemon.service.config import BUILT_IN, RigConfig, find_driver


def enable_line(rig: RigConfig) -> dict[str, bool] | None:
    """Whether the line can be proven and whether its absence is accepted; None without a shaker of ours.

    Raises
    ------
    ConfigError
        A driver is not installed.
    """
    if rig.shaker is None:
        return None
    holds, reports = False, False
    if rig.trigger.driver not in BUILT_IN["trigger"]:
        trigger: Any = find_driver("trigger", rig.trigger.driver).load()
        holds = holds_enable_line(trigger)
        shaker: Any = find_driver("shaker", rig.shaker.driver).load()("shaker", rig.shaker_settings())
        reports = reports_amplifier(shaker)
    sees = reports or any(gauge.role == "table" for gauge in rig.gauges)
    return {"can_be_proven": holds and sees, "accept_no_enable": rig.interlocks.accept_no_enable}


def sentence(line: dict[str, bool] | None) -> str | None:
    """The same for a person; None without a shaker."""
    if line is None:
        return None
    if line["can_be_proven"]:
        return "enable line: proven before the table moves (a small motion, the line alone dropped)"
    if line["accept_no_enable"]:
        return (
            "enable line: none that can be proven, accepted by accept_no_enable: nothing but the shaker stops the table"
        )
    return "enable line: none that can be proven, so `submit` refuses; see [interlocks] accept_no_enable"
