"""The settings of a simulated Nikon D80 as device properties: what its dials and menus leave to the host."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from labdrivers.ptp.codes import Prop

U8, U16, U32 = 2, 4, 6
FORMS = {U8: "<B", U16: "<H", U32: "<I"}
BULB = 0xFFFFFFFF
SLOW = ("30", "25", "20", "15", "13", "10", "8", "6", "5", "4", "3", "2.5", "2", "1.6", "1.3", "1")
FAST = (
    *("1/1.3", "1/1.6", "1/2", "1/2.5", "1/3", "1/4", "1/5", "1/6", "1/8", "1/10", "1/13", "1/15", "1/20", "1/25"),
    *("1/30", "1/40", "1/50", "1/60", "1/80", "1/100", "1/125", "1/160", "1/200", "1/250", "1/320", "1/400", "1/500"),
    *("1/640", "1/800", "1/1000", "1/1250", "1/1600", "1/2000", "1/2500", "1/3200", "1/4000"),
)
F_NUMBERS = (280, 320, 350, 400, 450, 500, 560, 630, 710, 800, 900, 1000, 1100, 1300, 1400, 1600, 1800, 2000, 2200)
SMALL_F_NUMBERS = (2500, 2900, 3200)
ISOS = (100, 125, 160, 200, 250, 320, 400, 500, 640, 800, 1000, 1250, 1600)
PROGRAMS = {"M": 1, "P": 2, "A": 3, "S": 4}


def nikon_raw(name: str) -> int:
    """``1/250`` or ``1.3`` as the D100 property has it: numerator << 16 | denominator."""
    top, _, bottom = name.partition("/")
    a, b = float(top), float(bottom or 1)
    scale = 10 if a != int(a) or b != int(b) else 1
    return round(a * scale) << 16 | round(b * scale)


def named_seconds(raw: int) -> float:
    """The name's value in seconds."""
    return (raw >> 16) / (raw & 0xFFFF)


def true_seconds(raw: int) -> float:
    """How long the shutter really stays open: names are rounded, shutters step by thirds of a stop from 1 s."""
    return float(2.0 ** (round(3 * math.log2(named_seconds(raw))) / 3))


SHUTTERS = tuple(nikon_raw(name) for name in (*reversed(FAST), *reversed(SLOW)))


@dataclass(slots=True)
class PtpProperty:
    """One setting."""

    type_code: int
    value: int
    values: tuple[int, ...]
    writable: Callable[[], bool]
    range_form: bool = False

    def pack(self, value: int | None = None) -> bytes:
        """A value's bytes."""
        return struct.pack(FORMS[self.type_code], self.value if value is None else value)


class BodySettings:
    """A D80 with its mode dial at `dial` (M, A, S or P).

    500D and D100 are two views of one shutter setting, writable on M and S only; the f-number on M and A.
    """

    def __init__(self, *, dial: str = "M", exposure: str = "1", f_number: int = 3200, iso: int = 100) -> None:
        self.dial = dial
        shutter_free = lambda: self.dial in "MS"  # noqa: E731
        always, never = (lambda: True), (lambda: False)
        raw = nikon_raw(exposure)
        self._table: dict[int, PtpProperty] = {
            Prop.BATTERY: PtpProperty(U8, 90, (0, 100, 1), never, range_form=True),
            Prop.COMPRESSION: PtpProperty(U8, 3, (0, 1, 2, 3, 4), always),
            Prop.F_NUMBER: PtpProperty(U16, f_number, (*F_NUMBERS, *SMALL_F_NUMBERS), lambda: self.dial in "MA"),
            Prop.EXPOSURE_TIME: PtpProperty(U32, _tenth_ms(raw), tuple(map(_tenth_ms, SHUTTERS)), shutter_free),
            Prop.EXPOSURE_MODE: PtpProperty(U16, PROGRAMS[dial], tuple(PROGRAMS.values()), never),
            Prop.ISO: PtpProperty(U16, iso, ISOS, always),
            Prop.NIKON_SHUTTER: PtpProperty(U32, raw, (*SHUTTERS, BULB), shutter_free),
        }

    def codes(self) -> list[int]:
        """Codes of all properties."""
        return list(self._table)

    def get(self, code: int) -> PtpProperty | None:
        """A property, None if the body does not have it."""
        return self._table.get(code)

    def set(self, code: int, value: int) -> bool:
        """Change a setting; False if the value is none of those allowed."""
        setting = self._table[code]
        if value not in setting.values:
            return False
        setting.value = value
        if code == Prop.EXPOSURE_TIME:
            self._table[Prop.NIKON_SHUTTER].value = next(raw for raw in SHUTTERS if _tenth_ms(raw) == value)
        elif code == Prop.NIKON_SHUTTER and value != BULB:
            self._table[Prop.EXPOSURE_TIME].value = _tenth_ms(value)
        return True

    @property
    def exposure_s(self) -> float:
        """True time the shutter stays open; bulb counts as a second here, no cable is held longer."""
        raw = self._table[Prop.NIKON_SHUTTER].value
        return 1.0 if raw == BULB else true_seconds(raw)

    @property
    def f_number(self) -> float:
        """Aperture."""
        return self._table[Prop.F_NUMBER].value / 100

    @property
    def iso(self) -> int:
        """Sensitivity."""
        return self._table[Prop.ISO].value

    def describe(self, code: int, *, read_only: bool = False) -> bytes:
        """The property's description as a dataset."""
        setting = self._table[code]
        writable = setting.writable() and not read_only
        head = struct.pack("<HHB", code, setting.type_code, int(writable)) + setting.pack() + setting.pack()
        values = b"".join(setting.pack(value) for value in setting.values)
        if setting.range_form:
            return head + b"\x01" + values
        return head + b"\x02" + struct.pack("<H", len(setting.values)) + values


def _tenth_ms(raw: int) -> int:
    return round(named_seconds(raw) * 1e4)
