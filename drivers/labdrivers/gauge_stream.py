"""From a gauge's bytes to its readings: text lines or binary records, found again after rubbish."""

from __future__ import annotations

import math
import struct


class LineParser:
    """Readings in text lines; one column of each is the value.

    Parameters
    ----------
    column
        Which, counted from 0.
    separator
        Between columns.
    """

    def __init__(self, *, column: int, separator: str) -> None:
        self._column, self._separator = column, separator
        self._rest = b""

    def feed(self, data: bytes) -> list[float]:
        """Readings in the lines that `data` completes; NaN for a line without a number."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-1000:]
        return [self._value(line) for line in lines if line.strip()]

    def _value(self, line: bytes) -> float:
        try:
            value = float(line.decode("ascii").split(self._separator)[self._column])
            if math.isfinite(value):
                return value
        except (ValueError, IndexError):  # no number in this line, as after a glitch of the wire
            pass
        return math.nan  # rubbish, or a gauge whose target is out of range


class RecordParser:
    """Readings in binary records of fixed size, each begun by a marker and, if so set, ended by a checksum.

    Parameters
    ----------
    marker
        First bytes of each record.
    form
        `struct` format of the value after it.
    checksum
        Whether a byte with the low byte of the sum of the value's bytes follows.
    """

    def __init__(self, *, marker: bytes, form: str, checksum: bool) -> None:
        self._marker, self._form, self._checksum = marker, form, checksum
        self._size = struct.calcsize(form)
        self._rest = b""

    def feed(self, data: bytes) -> list[float]:
        """Readings in the records that `data` completes."""
        data = self._rest + data
        whole = len(self._marker) + self._size + self._checksum
        values, at = [], 0
        while len(data) - at >= whole:
            body = data[at + len(self._marker) : at + len(self._marker) + self._size]
            right = data.startswith(self._marker, at) and (
                not self._checksum or sum(body) & 0xFF == data[at + whole - 1]
            )
            if right:
                values.append(float(struct.unpack(self._form, body)[0]))
                at += whole
                continue
            found = data.find(self._marker, at + 1)
            at = found if found >= 0 else max(at + 1, len(data) - len(self._marker) + 1)
        self._rest = data[at:]
        return values


Parser = LineParser | RecordParser
