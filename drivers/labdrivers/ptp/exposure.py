"""A body's exposure settings through PTP: what it offers is read each time, because its dials change it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from labdaemon.errors import DeviceRefused
from labdrivers.ptp.codes import Op, Prop
from labdrivers.ptp.container import pack_value
from labdrivers.ptp.datasets import PropertyDescription
from labdrivers.ptp.session import PtpSession

BULB = 0xFFFFFFF0
"""Values from here up are bulb, time and flash-synchronised, not durations."""
NEAR = 0.05
"""Relative difference within which a fixed setting counts as the one asked for."""


@dataclass(frozen=True, slots=True)
class ExposureTimes:
    """The property that holds the exposure time and how to read it."""

    description: PropertyDescription
    steps_s: dict[int, float]
    """Raw value -> seconds, for all values offered; the present one only, when the body's dial decides."""

    @property
    def current_s(self) -> float | None:
        """Present setting in seconds, None on bulb."""
        return raw_seconds(self.description.code, int(self.description.current))


def raw_seconds(code: int, raw: int) -> float | None:
    """Seconds in a raw value of 500D (0.1 ms) or Nikon's D100 (numerator and denominator); None for bulb."""
    if raw >= BULB or raw <= 0:
        return None
    if code == Prop.NIKON_SHUTTER:
        numerator, denominator = raw >> 16, raw & 0xFFFF
        return numerator / denominator if numerator and denominator else None
    return raw * 1e-4


def describe(session: PtpSession, code: int) -> PropertyDescription | None:
    """A property's description; None if the body does not have it."""
    if code not in session.info.properties:
        return None
    return PropertyDescription.parse(session.call(Op.GET_PROP_DESC, code).data)


def exposure_times(session: PtpSession) -> ExposureTimes:
    """Read the exposure times that the body offers now; Nikon's own property where it is writable, it is exact."""
    found = [d for code in (Prop.NIKON_SHUTTER, Prop.EXPOSURE_TIME) if (d := describe(session, code)) is not None]
    if not found:
        raise DeviceRefused("does not tell its exposure time", device=session.device)
    chosen = next((d for d in found if d.writable and d.values), found[0])
    raws = [int(value) for value in chosen.values] if chosen.writable else [int(chosen.current)]
    steps = {raw: s for raw in raws if (s := raw_seconds(chosen.code, raw)) is not None}
    return ExposureTimes(chosen, steps)


def set_exposure(session: PtpSession, exposure_s: float) -> float:
    """Set the offered step nearest to `exposure_s`; return the body's own value for it, read back."""
    times = exposure_times(session)
    current = times.current_s
    if not times.description.writable:
        if current is not None and abs(current / exposure_s - 1) <= NEAR:
            return current
        now = "bulb" if current is None else f"{current:g} s"
        raise DeviceRefused(
            f"its own dial sets the exposure time ({now}); turn the mode dial to M, or set {exposure_s:g} s there",
            device=session.device,
        )
    if not times.steps_s:
        raise DeviceRefused("offers no exposure times now; turn the mode dial to M", device=session.device)
    raw = min(times.steps_s, key=lambda value: abs(math.log(times.steps_s[value] / exposure_s)))
    _write(session, times.description, raw, f"{times.steps_s[raw]:g} s")
    return times.steps_s[raw]


def set_nearest(session: PtpSession, code: int, value: float, what: str) -> None:
    """Set an enumerated or free setting to the offered value nearest to `value`, which must be near enough."""
    description = describe(session, code)
    if description is None:
        raise DeviceRefused(f"has no setting for {what}", device=session.device)
    current = int(description.current)
    offered = [int(v) for v in description.values] if description.writable else [current]
    nearest = min(offered or [round(value)], key=lambda v: abs(v - value))
    if abs(nearest - value) > NEAR * abs(value):
        choice = ", ".join(str(v) for v in offered)
        how = "choose one of" if description.writable else "turn the body's dial; it is fixed at"
        raise DeviceRefused(f"does not take {what} {value:g}: {how} {choice} (raw)", device=session.device)
    if nearest != current:
        _write(session, description, nearest, f"{what} {nearest}")


def _write(session: PtpSession, description: PropertyDescription, raw: int, what: str) -> None:
    if raw != description.current:
        session.call(Op.SET_PROP_VALUE, description.code, data_out=pack_value(description.type_code, raw))
    again = describe(session, description.code)
    if again is None or again.current != raw:
        now = "nothing" if again is None else str(again.current)
        raise DeviceRefused(f"was set to {what} but reports {now}; is its dial on M?", device=session.device)
